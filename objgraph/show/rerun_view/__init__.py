"""Maps, solves and growing maps in the viewer rerun: an optional part.

    pip install 'objgraph[view]'

```python
from objgraph.show import rerun_view

recording = rerun_view.new_recording("my room")
for frame, detections in stream:
    objects.update(frame, detections)  # an IncrementalObjectGraph
    rerun_view.log_incremental(objects, frame, recording)
rerun_view.save_recording(recording, "room.rrd")  # or show_recording(recording)
```
"""

from objgraph.errors import ViewError

try:
    import rerun  # noqa: F401
except ImportError as error:
    raise ViewError("the viewer needs the package rerun-sdk: pip install 'objgraph[view]'") from error

from objgraph.show.rerun_view.incremental import log_incremental
from objgraph.show.rerun_view.iterations import Iterates, log_iterations
from objgraph.show.rerun_view.layout import map_layout
from objgraph.show.rerun_view.objects import log_objects
from objgraph.show.rerun_view.recording import (
    check_recording,
    has_display,
    new_recording,
    save_recording,
    show_recording,
)
from objgraph.show.rerun_view.scan import log_frames, log_points

__all__ = [
    "Iterates",
    "check_recording",
    "has_display",
    "log_frames",
    "log_incremental",
    "log_iterations",
    "log_objects",
    "log_points",
    "map_layout",
    "new_recording",
    "save_recording",
    "show_recording",
]
