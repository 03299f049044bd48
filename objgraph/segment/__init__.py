"""Object masks from colour images by Mask2Former (Cheng et al., CVPR 2022): an optional front-end.

    pip install 'objgraph[segment]'

```python
from objgraph.segment import Segmenter

segments = Segmenter.load("facebook/mask2former-swin-small-coco-instance").segment(rgb)  # (h, w, 3), uint8
```
"""

from objgraph.segment.mask2former import CATEGORIES, Segment, SegmentConfig, Segmenter
from objgraph.segment.masks import detection_masks, instance_masks

__all__ = ["CATEGORIES", "Segment", "SegmentConfig", "Segmenter", "detection_masks", "instance_masks"]
