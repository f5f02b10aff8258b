"""The coefficients that can be free, what is supposed of them beforehand, and the motion linearised by them."""
