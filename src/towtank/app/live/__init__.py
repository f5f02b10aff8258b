"""`towtank live`: the session run, its view on a terminal, its document at the end, its reports."""
