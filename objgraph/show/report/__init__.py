"""A map as one HTML file: its meshes over the scan's points to turn about, a table to sort, and each object's views."""

from objgraph.show.report.page import REPORT, write_report
from objgraph.show.report.views import ObjectPicture, object_pictures

__all__ = ["REPORT", "ObjectPicture", "object_pictures", "write_report"]
