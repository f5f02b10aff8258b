"""Free runs of the model fitted to recordings: the output error method and what it is judged by."""
