"""The commands of `towtank`: their options and what they call."""
