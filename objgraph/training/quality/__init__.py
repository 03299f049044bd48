"""What a prior is worth on shapes that it has not seen."""
