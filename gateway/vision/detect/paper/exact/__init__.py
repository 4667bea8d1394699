"""The paper's method without looking at every pixel: the same mask, contour and circle, to the last bit.

`geometry` has the proof and its limits. Pure: `geometry`, `grid`, `window`, `search`, `tracker`. IO: `build`
(runs the C compiler), `kernel` (loads the result).
"""
