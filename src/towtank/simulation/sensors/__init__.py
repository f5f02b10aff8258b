"""What watches a simulated vehicle."""
