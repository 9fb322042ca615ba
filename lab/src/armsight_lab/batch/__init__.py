"""Many jobs on many workers: run_batch in app.batch.run."""
