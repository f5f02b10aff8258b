"""What is kept of a live session: everything that came, what was learned, messages for viewers."""
