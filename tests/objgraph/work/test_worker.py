"""What a process that works is told of memory."""

import subprocess
import sys

import pytest

_CLEARED = """
import resource, sys
from objgraph.work import keep_memory
if sys.argv[1] == "keep":
    keep_memory()
def work():
    return sum(len(each) for each in [b"x" * (6 * 2**20) for _ in range(8)])
work(), work()
before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
for _ in range(5):
    work()
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="memory is kept by glibc's mallopt")
def test_memory_that_is_kept_is_not_cleared_by_the_system_again():
    freed, kept = (
        int(subprocess.run([sys.executable, "-c", _CLEARED, how], capture_output=True, check=True).stdout)
        for how in ("free", "keep")
    )
    pages = 5 * 8 * 6 * 2**20 // 4096
    assert freed > pages / 2
    assert kept < pages / 50
