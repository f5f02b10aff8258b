"""A mapping to fill in: what a log of unknown columns holds, what its names and numbers suggest, as a mapping file."""
