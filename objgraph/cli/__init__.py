"""The command `objgraph`: one file a verb."""

from objgraph.cli.main import main as main
