"""How well it all works, beside other methods."""
