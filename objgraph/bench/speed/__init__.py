"""How fast the program is, as ratios that are measured in turns on one machine."""
