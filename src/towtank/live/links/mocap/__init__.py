"""Motion capture systems by their own protocols."""
