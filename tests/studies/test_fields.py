"""A seeded sample of the study of what is typed into explore."""

import fields
import pytest

pytestmark = [
    pytest.mark.studies,
    pytest.mark.skipif(fields.chromium() is None, reason="no Chromium on this machine: apt-get install chromium"),
]


@pytest.mark.release
def test_what_is_typed_is_neither_lost_nor_altered_nor_executed():
    with fields.browser(fields.chromium()) as chrome:
        kinds, bad = fields.tried(24, 7, chrome)
    assert sum(kinds.values()) == 24
    assert bad == []
