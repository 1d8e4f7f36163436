"""How long commands take to start."""

import pytest
import start


@pytest.mark.benchmark
def test_start():
    start.main()
