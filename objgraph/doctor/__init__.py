"""Is the installation whole, and are the data understood? Facts, and what is wrong with what to do."""

from objgraph.doctor.lidar import examine_lidar
from objgraph.doctor.machine import examine_machine
from objgraph.doctor.scan import Examined, examine_scan
from objgraph.doctor.section import Finding, Section

__all__ = ["Examined", "Finding", "Section", "examine_lidar", "examine_machine", "examine_scan"]
