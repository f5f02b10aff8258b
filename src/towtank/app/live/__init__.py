"""The live session of the command line."""
