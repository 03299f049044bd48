"""Object-level mapping with learnt shape priors, as a factor graph."""
