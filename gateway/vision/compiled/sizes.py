"""Sizes of the compiled loops' arrays and strides: the one place for C, where they are compiled in, and for NumPy.

A library that was built with others is stale (`build.source_sum`). Whole numbers only; standard library only.
The robust method's other numbers are in `gateway.vision.detect.robust.constants`.
"""

# The paper's method.
HALO_PX = 2  # pixels that a blur of side 5 needs beyond each end of a row
CHUNK_PX = 32  # of a verdict on whether any of them may be red

# The robust method: candidates.
CELL = 2  # px of a level in a cell of the votes
MARGIN = 3  # cells round the picture: a centre may lie a little outside
PEAKS = 7  # of a level
THRESHOLDS = 8  # of redness
BLOBS = 5  # of a threshold

# Evidence.
RADIAL = 48  # rays from a candidate's centre
BEFORE_EDGE = 2  # samples on either side of an edge
NEXT_TO_RIM = 3  # samples next to the rim
CORE_FIRST, CORE_LAST, CORE_END = 1, 3, 5  # samples 0.2 to 0.4 of the way to the rim; those up to 0.5

# Rim.
COARSE_RAYS = 72
HALF_STEPS = 16  # of a coarse ray, to either side
MOST_RAYS, LEAST_RAYS, RAYS_STEP = 320, 64, 32  # of the fine stage: numbers of rays are multiples of the last
FALL_RAYS = 32  # a step of the rays of the fine stage, whose tables it shares
SECTORS = 16
PROFILE_STEPS = 13  # at most
SMOOTH_ROWS = 21

# Veil.
VEIL_CELLS = 8  # along the longer side of the picture that it is estimated on
MOST_VEIL_SIDE = 160  # px, of that side, at most
