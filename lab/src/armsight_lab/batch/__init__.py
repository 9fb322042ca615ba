"""Many jobs on many workers: run_batch in armsight_lab.batch.run."""
