"""Samples of recordings at their own times, inputs held over intervals, and how noisy each channel is."""
