"""What is the same for everybody who runs the tests, so that a red test is red for everybody.

Property tests search the same examples in every run. `pytest --hypothesis-profile=wild` searches new ones: for finding
faults, not for judging a change. `brief` searches a tenth of them: `./dev test` uses it on the interpreters other than
the main one.

The programs that tests start see a user's environment: with PYTHONUNBUFFERED, which build machines set, some faults of
a program's end do not show.
"""

import os
from collections import Counter

import pytest
from hypothesis import settings

for name in [name for name in os.environ if name.startswith("PYTHON")]:
    del os.environ[name]

settings.register_profile("steady", derandomize=True, deadline=None)
settings.register_profile("brief", settings.get_profile("steady"), max_examples=10)
settings.register_profile("wild", deadline=None, max_examples=300)
settings.load_profile("steady")


@pytest.hookimpl(tryfirst=True)  # before `-m` deselects
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """`mostly_long(short=1)`: all but the first `short` parameter sets of the test are `long`."""
    seen: Counter[str] = Counter()
    for item in items:
        if (marker := item.get_closest_marker("mostly_long")) is not None:
            test = item.nodeid.partition("[")[0]
            seen[test] += 1
            if seen[test] > marker.kwargs.get("short", 1):
                item.add_marker(pytest.mark.long)
