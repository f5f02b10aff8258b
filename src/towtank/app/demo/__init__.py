"""`towtank demo`: the session run, its learning curve, its table, the page's feed, and the files it leaves."""
