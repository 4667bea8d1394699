"""The paper's method without looking at every pixel: the same mask, contour and circle, to the last bit.

`geometry` says why that is so, and where it ends. Pure: `geometry`, `grid`, `window`, `search`, `tracker`. IO: `build`
(runs the C compiler), `kernel` (loads the result).
"""
