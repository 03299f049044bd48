"""Objects from a LiDAR's scan and a detector's boxes."""
