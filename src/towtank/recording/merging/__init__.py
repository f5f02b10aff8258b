"""Two files of one run as one recording."""
