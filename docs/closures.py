"""Draw closures.png and rewrite the tables of closures.md: ``python docs/closures.py``."""

import warnings
from contextlib import suppress
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from grainmesh.closures import LAWS, ClosureWarning, Law, lattice_gap
from grainmesh.errors import InputError

HERE = Path(__file__).parent
BEGIN, END = "<!-- tables: python docs/closures.py -->\n", "<!-- end of tables -->\n"
EXACT = {"square": LAWS["square-lattice"], "hexagonal": LAWS["hexagonal-lattice"]}
RANDOM = (0.35, 0.9)  # porosities at which Eq. (4) was compared with resolved random arrays
DRAWN = {  # law: colour; the inertial form of a Stokes law coincides with it at Re = 0
    "microstructural": "#d62728",
    "gebart-square": "#1f77b4",
    "gebart-hexagonal": "#1f77b4",
    "drummond-tahir-square": "#2ca02c",
    "drummond-tahir-hexagonal": "#2ca02c",
    "lee-yang": "#9467bd",
    "kuwabara": "#ff7f0e",
    "happel": "#8c564b",
    "carman-kozeny": "#7f7f7f",
    "ergun-2d": "#bcbd22",
}


def compared(law: Law, lattice: str) -> bool:
    """Whether a law is set against a lattice: all are, but for the laws of the other lattice."""
    return getattr(law, "lattice", lattice) == lattice


def answer(law: Law, lattice: str, eps: np.ndarray) -> np.ndarray:
    """λ with the gap of a lattice, nan where the medium of the law has closed."""
    lam = np.full(eps.shape, np.nan)
    for i, (e, gap) in enumerate(zip(eps, lattice_gap(lattice, eps), strict=True)):
        with suppress(InputError):
            lam[i] = law(e, gap)
    return lam


def inside(law: Law, eps: np.ndarray) -> np.ndarray:
    """Which porosities lie in the range of a law."""
    low, high = RANDOM if law.variable == "gap" else law.valid
    return (eps > low) & (eps < high)


def span(law: Law, lattice: str) -> str:
    """Smallest and largest deviation from a lattice inside the range of the law, as text."""
    if not compared(law, lattice):
        return "–"
    eps = np.linspace(EXACT[lattice].valid[0] + 1e-4, 1.0 - 1e-4, 2000)
    eps = eps[inside(law, eps)]
    deviation = 100.0 * (answer(law, lattice, eps) / EXACT[lattice](eps, 1.0) - 1.0)
    low, high = (0.0 if abs(v) < 0.05 else v for v in (deviation.min(), deviation.max()))
    return "exact" if low == high == 0.0 else f"{low:+.1f} to {high:+.1f} %"


def tables() -> str:
    """Both tables of the page, in Markdown."""
    rows = [
        "| Law | Medium | Variable | Range | Stated error | Reference |",
        "|---|---|---|---|---|---|",
    ]
    for name, law in LAWS.items():
        low, high = law.valid
        rows.append(
            f"| `{name}` | {law.medium} | {law.variable} | {low:.3g} to {high:.3g} "
            f"| {100 * law.error:.3g} % | {law.reference} |"
        )
    rows += [
        "",
        "| Law | against the square lattice | against the hexagonal lattice |",
        "|---|---|---|",
    ]
    for name, law in LAWS.items():
        rows.append(f"| `{name}` | {span(law, 'square')} | {span(law, 'hexagonal')} |")
    return "\n".join(rows) + "\n"


def curve(ax: plt.Axes, law: Law, eps: np.ndarray, y: np.ndarray, **style: object) -> None:
    """A law as a full line inside its range and a faint one outside."""
    ax.plot(eps, np.where(inside(law, eps), y, np.nan), lw=1.8, **style)
    ax.plot(eps, y, lw=0.8, alpha=0.4, **{**style, "label": None})


def figure() -> plt.Figure:
    """K/d² of every law, and every law over each exact lattice."""
    fig, (left, *ratios) = plt.subplots(1, 3, figsize=(12.5, 5.2), layout="constrained")
    for (lattice, exact), dash, ax in zip(EXACT.items(), ("-", "--"), ratios, strict=True):
        eps = np.linspace(exact.valid[0] + 0.005, 0.98, 400)
        left.plot(eps, exact(eps, 1.0), "k", ls=dash, lw=2.4, label=exact.name, zorder=3)
        for name, colour in DRAWN.items():
            law = LAWS[name]
            if not compared(law, lattice):
                continue
            lam = answer(law, lattice, eps)
            curve(ax, law, eps, lam / exact(eps, 1.0), color=colour)
            # On the left a law stands once, but for the law of the gap: its gap is the lattice's.
            if law.variable == "gap":
                curve(left, law, eps, lam, color=colour, ls=dash, label=f"{name}, {lattice} gap")
            elif hasattr(law, "lattice"):
                curve(left, law, eps, lam, color=colour, ls=dash, label=name)
            elif lattice == "hexagonal":
                curve(left, law, eps, lam, color=colour, ls="-.", label=name)
        ax.axhline(1.0, color="k", lw=1)
        ax.set(yscale="log", ylim=(0.6, 5), title=f"Law over exact {lattice} lattice")
        ax.set_yticks([0.7, 1, 1.5, 2, 3, 4], ["0.7", "1", "1.5", "2", "3", "4"])
        ax.minorticks_off()
    left.set(yscale="log", ylim=(1e-4, 5), title="Permeability across the discs")
    left.set_ylabel("λ = K/d²")
    fig.legend(loc="outside lower center", ncols=5, fontsize=8, frameon=False)
    for ax in (left, *ratios):
        ax.set(xlim=(0.08, 1.0), xlabel="porosity ε")
        ax.title.set_fontsize(11)
        ax.spines[["top", "right"]].set_visible(False)
        ax.grid(alpha=0.2)
    return fig


def main() -> None:
    """Write the figure and the tables."""
    warnings.simplefilter("ignore", ClosureWarning)  # the page shows laws outside their range too
    figure().savefig(HERE / "closures.png", dpi=80, pil_kwargs={"optimize": True})
    page = HERE / "closures.md"
    head, rest = page.read_text(encoding="utf-8").split(BEGIN)
    page.write_text(head + BEGIN + tables() + END + rest.split(END)[1], encoding="utf-8")


if __name__ == "__main__":
    main()
