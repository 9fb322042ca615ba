"""The history of cells: what calibrations and verifications found, filed, looked through, and judged for drift."""
