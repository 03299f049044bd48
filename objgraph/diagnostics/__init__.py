"""Why a graph cannot be solved, and where its cost is."""
