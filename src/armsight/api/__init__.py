"""The public face: arrays in, records out. Its names are reached as `armsight.NAME`; everything else is private."""
