"""Results as tables for a terminal and as parts of the JSON documents, a file for each kind of result."""
