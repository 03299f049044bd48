"""How shape priors are made and measured; nothing of it is needed to map."""
