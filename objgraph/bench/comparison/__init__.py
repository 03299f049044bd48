"""Methods compared on the same objects: the harness behind `objgraph evaluate`."""
