"""What the data say of each coefficient: estimates, what they can tell, what is physical, in words."""
