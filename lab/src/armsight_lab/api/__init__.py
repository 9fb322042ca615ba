"""The public face of these, reached as `armsight.NAME`."""
