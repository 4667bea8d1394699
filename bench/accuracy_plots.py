"""Plots of what `bench.accuracy` measured. Needs matplotlib."""

from pathlib import Path

import matplotlib as mpl
import numpy as np

from bench.accuracy import ALL, METHODS, REFINED, Shot

mpl.use("Agg")
from matplotlib import pyplot as plt

COLOURS = dict(zip(METHODS, ("#c0392b", "#7f8c8d", "#2980b9", "#16a085", "#d68910"), strict=True))
SMALLEST, LARGEST = 1e-3, 300.0  # px, of the logarithmic axes


def plot_all(groups: dict[str, list[Shot]], folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    percentiles(groups, folder / "accuracy-methods.png")
    radii(groups, folder / "accuracy-radius.png")


def percentiles(groups: dict[str, list[Shot]], path: Path) -> None:
    """p50 (dot) to p95 (end of the line) of every method in every condition, centre and radius."""
    figure, axes = plt.subplots(1, 2, figsize=(12, 0.62 * len(groups) + 1.6), sharey=True)
    for which, (axis, title) in enumerate(zip(axes, ("centre error, px", "radius error, px"), strict=True)):
        for row, (name, every) in enumerate(groups.items()):
            axis.plot([ALL[name].limit] * 2, [row - 0.4, row + 0.4], color="black", lw=1, ls=":", zorder=1)
            for place, method in enumerate(METHODS):
                answers = [shot.errors[method] for shot in every if method in shot.errors]
                errors = [abs(answer[which]) if answer else LARGEST for answer in answers]
                if not errors:
                    continue
                middle, high = np.clip(np.percentile(errors, [50, 95]), SMALLEST, LARGEST)
                at = row + (place - 2) * 0.15
                axis.plot([middle, high], [at, at], color=COLOURS[method], lw=2.2, solid_capstyle="butt")
                axis.plot(middle, at, "o", ms=4, color=COLOURS[method], label=method if not row else None)
        axis.set_xscale("log")
        axis.set_xlim(SMALLEST, LARGEST)
        axis.set_xlabel(f"{title}: median (dot) to 95th percentile (end)")
        axis.grid(axis="x", alpha=0.3)
    axes[0].set_yticks(range(len(groups)), list(groups))
    axes[0].invert_yaxis()
    figure.legend(*axes[0].get_legend_handles_labels(), loc="lower center", ncols=len(METHODS), fontsize=9)
    figure.suptitle("Every method on the same pictures; dotted: what is asked of 95 % of them", fontsize=11)
    figure.tight_layout(rect=(0, 0.03, 1, 1))
    figure.savefig(path, dpi=110)
    plt.close(figure)


def radii(groups: dict[str, list[Shot]], path: Path) -> None:
    """The refined rim's errors over the disc's size, with the Cramer-Rao floor where it was computed."""
    chosen = [name for name in ("clean", "noisy", "dusty", "occluded", "truncated", "all together") if name in groups]
    figure, axes = plt.subplots(
        2, len(chosen), figsize=(2.6 * len(chosen), 5.2), sharex=True, sharey=True, squeeze=False
    )
    for column, name in enumerate(chosen):
        shots = [(shot, answer) for shot in groups[name] if (answer := shot.errors[REFINED])]
        radius = [shot.radius for shot, _ in shots]
        floors = [(shot.radius, shot.floor) for shot, _ in shots if shot.floor]
        for which, axis in enumerate(axes[:, column]):
            errors = [max(abs(answer[which]), SMALLEST / 3) for _, answer in shots]
            axis.plot(radius, errors, ".", ms=3, color=COLOURS[REFINED], alpha=0.6, label="refined rim")
            axis.plot(
                [r for r, _ in floors], [f[which] for _, f in floors], "k_", ms=6, label="Cramer-Rao floor (sigma)"
            )
            axis.axhline(ALL[name].limit, color="black", lw=1, ls=":")
            axis.set_xscale("log")
            axis.set_yscale("log")
            axis.set_ylim(SMALLEST / 4, 2)
            axis.set_xticks([50, 100, 200], ["50", "100", "200"])
            axis.minorticks_off()
            axis.grid(alpha=0.25)
        axes[0, column].set_title(name, fontsize=10)
        axes[1, column].set_xlabel("R, px")
    axes[0, 0].set_ylabel("centre error, px")
    axes[1, 0].set_ylabel("radius error, px")
    axes[0, 0].legend(fontsize=7, loc="upper right")
    figure.tight_layout()
    figure.savefig(path, dpi=110)
    plt.close(figure)
