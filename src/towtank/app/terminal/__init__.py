"""Output, errors and exit codes of a command; spark lines."""
