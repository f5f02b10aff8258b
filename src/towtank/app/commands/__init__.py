"""The commands of `towtank`, a file each: options and what they call; `arguments` holds what several share."""
