"""Methods compared by the boxes of detected objects: the paper's Table III."""
