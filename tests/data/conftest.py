"""What several files of this room use."""

import pytest

from tests.models.pushed_arm import pushed_arm


@pytest.fixture(scope="module")
def simulator():
    """An arm that may be pushed."""
    return pushed_arm()
