"""What all readers share: decoded tables, their sources and clocks, and how they become a recording."""
