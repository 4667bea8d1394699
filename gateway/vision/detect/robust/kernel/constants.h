/* The numbers that the reference in NumPy has, too: `constants.py`, in its order, handed over by whoever calls. */
#ifndef GATEWAY_CONSTANTS_H
#define GATEWAY_CONSTANTS_H

typedef struct {
    double tie, filter_sigma, filter_reach, blind;
    double tukey, quantile_40, fit_ridge, fewest_edges;
    double still_sigmas, least_visible, rounds, smallest_axis_px, largest_axis_px;
    double evidence_radius_px, edge_step, white, shown, darkest, full_veil, most_haze;
    double same_worth, circular, least_bottom, least_trust, fewest_points, ellipse_rounds;
    double least_gradient, ridge_share, fewest_voters, least_vote, same_vote, least_spread, least_fill, most_longer;
    double bright, darkest_airlight, most_green, no_veil, least_part;
    double least_red, as_red, full_redness, smallest_region_px;
} Constants;

#endif
