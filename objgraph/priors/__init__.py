"""Shape priors: what is known of a category before an object is seen."""
