"""The numbers of the robust method that its reference in NumPy and its compiled loops both use: they stand here only.

They are compiled in: a library that was built with others is stale (`gateway.vision.compiled.build`). What sizes an
array or a stride is in `gateway.vision.compiled.sizes`. Standard library only.
"""

# Rim, coarse (`rim_coarse`).
TIE = 1e-7  # grey levels: of slopes that differ by no more the first is taken, whatever the order of a sum
FILTER_SIGMA = 1.2  # of the edge filter, in steps along the ray
FILTER_REACH = 4  # steps
BLIND = 3  # steps at either end of a ray

# Rim, fit (`support`).
TUKEY = 4.0  # some 90 % efficient for Gaussian residuals
QUANTILE_40 = 0.5244  # of the absolute values of a standard Gaussian
FIT_RIDGE = 1e-6  # share of the weight: only keeps the equations solvable
FEWEST_EDGES = 8

# Rim, fine (`rim_fine`, `rim`).
STILL_SIGMAS = 0.15  # of the blur: the step's shift is linear so far, smaller moves need no further round
LEAST_VISIBLE = 0.15  # of the entire rim's rays: fewer are not a rim
ROUNDS = 4  # at most
SMALLEST_AXIS_PX = 3.0  # a semi-axis
LARGEST_AXIS_PX = 20_000.0

# Evidence (`evidence`).
EVIDENCE_RADIUS_PX = 14.0  # radius, px of its level, from which on a candidate is measured
EDGE_STEP = 0.3  # of the usual change of colour across the rim: so much is an edge, between two reds, too
WHITE = 248  # grey level of the darkest channel
SHOWN = 0.4  # of the usual contrast: a ray with so much shows the rim
DARKEST = 0.05  # share of a place that are its darkest parts
FULL_VEIL, MOST_HAZE = 220.0, 0.75  # grey level of a full veil

# Ellipses through points (`ellipses`).
SAME_WORTH = 1e-7  # of two equally good circles the first counts, whatever the last bits of their sums
CIRCULAR = 1e-9  # an ellipse so nearly round has no direction: its angle would be that of the last bits
LEAST_BOTTOM = 0.05  # 1 for a circle, 0 for a parabola
LEAST_TRUST = 1e-6
FEWEST_POINTS = 8
ELLIPSE_ROUNDS = 5

# Votes and blobs (`candidates`).
LEAST_GRADIENT = 0.01  # of redness, per px: less is rounding
RIDGE_SHARE = 0.9  # of the largest gradient around
FEWEST_VOTERS = 8
LEAST_VOTE = 0.12  # share of a full circle
SAME_VOTE = 1e-6  # peaks side by side that differ by no more are equal, and both count
LEAST_SPREAD = 0.04  # of redness, from the median to the largest
LEAST_FILL = 0.45  # of the box round a blob; a disc: pi / 4
MOST_LONGER = 2.2  # than the other side of that box

# Veil (`veil`).
BRIGHT = 0.7  # quantile of each channel that is the airlight, where there is any
DARKEST_AIRLIGHT = 20.0  # grey levels
MOST_GREEN = 1.1  # of the larger of blue and red: dust is grey in the light of sky or lamps; what is green is leaves
NO_VEIL = 0.6  # darkest share near a place: below, its air is clear
LEAST_PART = 0.5  # of the picture that lies behind dust where there is any; less is a bright wall, or the sky

# Other red things (`red_change`).
LEAST_RED = 0.15  # log(R/G): a marker behind much dust still has this
AS_RED = 0.5  # what appears is new if it is at least so red, compared with what is followed
FULL_REDNESS = 2.0  # log units, less the veil: red paint; more is only darker
SMALLEST_REGION_PX = 12  # area of a red spot in the sparse picture that counts: a disc of radius 2
