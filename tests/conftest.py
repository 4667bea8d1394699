"""Property tests search the same examples in every run, so that a red test is red for everybody.

`pytest --hypothesis-profile=wild` searches new ones: for finding faults, not for judging a change.
"""

from hypothesis import settings

settings.register_profile("steady", derandomize=True, deadline=None)
settings.register_profile("wild", deadline=None, max_examples=300)
settings.load_profile("steady")
