"""Every data set: one of its files damaged, missing, or of other numbers."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.fuzz.inputs import attempt, files_in, fuzzed, replaced
from tests.fuzz.scans import SCANS
from tests.fuzz.strategies import damaged


@pytest.fixture(scope="module", params=SCANS)
def scan(request, tmp_path_factory):
    """A good scan's folder, and what reads it."""
    write, read = SCANS[request.param]
    root = tmp_path_factory.mktemp("scan")
    write(root)
    return root, read


def test_what_is_damaged_is_good_before(scan):
    root, read = scan
    read(root)


@fuzzed
@given(data=st.data())
def test_a_scan_with_a_damaged_file(scan, data):
    root, read = scan
    path = data.draw(st.sampled_from(files_in(root)))
    with replaced(root, path, data.draw(damaged(path))):
        attempt(read, root)
