"""The numbers of the robust method that its reference in NumPy and its compiled loops both use: they stand here only.

They are compiled in: a library that was built with others is stale (`gateway.vision.compiled.build`). What sizes an
array or a stride is in `gateway.vision.compiled.sizes`. Standard library only.
"""

# Samples across a rim (`normal_profiles`).
OPPONENT = 1.5  # grey levels a unit of a*: a red disc then is about as far from grey as it is in B, G and R

# Rim, coarse (`rim_coarse`).
TIE = 1e-7  # grey levels: of slopes that differ by no more the first is taken, whatever the order of a sum
FILTER_SIGMA = 1.2  # of the edge filter, in steps along the ray
FILTER_REACH = 4  # steps
BLIND = 3  # steps at either end of a ray
LEAST_SLOPE, MOST_SLOPE = 0.3, 1.5  # of the usual one: less is no edge, more does not weigh more
COARSE_STEP_PX, SHARP = 1.0, 0.4  # wider steps can't distinguish sharp from soft: so much of the blur is believed
LEAST_BLUR_PX, MOST_BLUR_PX = 0.8, 3.0
AGREED_PX, AGREED_SHARE, AGREED_STEPS = 0.8, 0.01, 0.5  # an edge so near the rim agrees: px, of its size, steps
COARSE_SCALE_PX, COARSE_ROUNDS = 0.1, 2  # of the fit
FARTHEST = 0.8  # of the semi-minor axis: the rim is searched for no farther off

# Rim, fit (`support`).
DOUBT = 4.0  # an ellipticity of so many (squared) sigma is taken for noise and the rim for a circle
TUKEY = 4.0  # some 90 % efficient for Gaussian residuals
SCALE_QUANTILE, QUANTILE_SIGMAS = 0.4, 0.5244  # of the absolute values of a standard Gaussian
SCALED_ROUNDS = 2  # then the rim no longer moves, and further rounds only settle the weights
FIT_RIDGE = 1e-6  # share of the weight: only keeps the equations solvable
FEWEST_EDGES = 8

# Rim, fine (`rim_fine`).
ROOM = 0.75  # of the semi-minor axis: a ray reaches no farther inside
STEP_PX, STEP_SIGMAS, LEAST_STEPS = 0.75, 0.6, 4  # along a ray; in the room there are so many, at least
RAY_SIGMAS, RAY_PX, SHORTEST_RAY_PX = 2.5, 1.0, 3.0  # to either side
FRAME_PX = 2.0  # and the blur: so far from the frame's edge an edge is inside
FINE_SCALE_PX, LARGEST_SCALE_PX, LARGEST_SCALE, FINE_ROUNDS = 0.03, 0.6, 0.01, 3  # of the fit
SHARPEST_PX, SOFTEST, SOFTEST_PX = 0.5, 0.3, 1.0  # of the blur; of the semi-minor axis, or px
SHRUNK, GROWN = 0.3, 0.4  # of the blur: a guess that was so far off is measured with again
NOISE_FLOOR, QUIET_QUANTILE, QUIET = 0.1, 0.35, 1.4  # grey levels squared; the quietest rays; of their noise: plain
CLEAR, LEAST_CLEAR = 0.1, 0.05  # of the usual power: a ray counts; of the neighbours that do
MOST_VARIANCE = 3.0  # of the blur's, more or less
STRANGE, STRANGE_GREY2 = 0.4, 200.0  # so far off the median colour inside, squared: of the power, and grey levels
MOST_POWER, LEAST_POWER = 2.0, 9.0  # of the usual one; grey levels squared
SHIFT_SIGMAS, SHIFT_PX = 1.5, 1.0  # farther off is another edge
BLUR_RIDGE, BLUR_WAVE_RIDGE = 1e-6, 1e-3  # a blur that is the same in all directions, where too little is seen
STILL_SIGMAS = 0.15  # of the blur: the step's shift is linear so far, smaller moves need no further round
LEAST_VISIBLE = 0.15  # of the entire rim's rays: fewer are not a rim
ROUNDS = 4  # at most
SMALLEST_AXIS_PX = 3.0  # a semi-axis
LARGEST_AXIS_PX = 20_000.0

# Evidence (`evidence`).
EVIDENCE_RADIUS_PX = 14.0  # radius, px of its level, from which on a candidate is measured
SEED_PX, SEED_SHARE = 0.5, 0.08  # an edge so near agrees with a seed's circle: px, and of its radius
SEED_SMALLEST, SEED_LARGEST = 0.4, 2.0  # of the seed's radius
NEAR_PX, NEAR_SHARE, NEAR_ROUNDS = 0.7, 0.14, 2  # the same for an ellipse, which is fitted so many times
NEAR_SMALLEST, NEAR_LARGEST = 0.3, 3.0
LEAST_FALL, MOST_FALL, LEAST_USUAL = 0.25, 1.5, 0.02  # of redness on a ray, of the usual one; that, log units
SIGMAS = 1.48  # of a Gaussian, a median of absolute values
FEWEST_RAYS = 8  # in the picture
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

# Round a disc (`rings`).
LEAST_OUTWARDS, NEXT_OUTWARDS = 4, 3  # shares: from where on a rim is another one; so many farther the red has ended
REDDISH = 0.5  # of the way from what lies round to the inner disc's redness
MOST_RED, FEW_RED = 0.6, 0.35  # of the rays in the picture: so many are red; so few are still
RAYS_SEEN = 20  # at least
GROUND = 0.2  # quantile of the redness round it

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
