"""Who performs the tasks: processes of this machine, or the workers of a dask scheduler."""
