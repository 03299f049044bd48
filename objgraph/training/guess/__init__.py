"""First guesses: scenes, networks, and what they are worth."""
