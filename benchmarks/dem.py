"""Speed of discs in motion, with LIGGGHTS and YADE beside ours where installed.

    python benchmarks/dem.py [--quick | --full]

Loose discs fall into a bed; the bed, and ten of them side by side, then rest. All codes get the
same states and do the same work: linear spring-dashpot contacts, tangential springs with history,
walls, gravity. Only the loops over time steps are timed, each code on one thread, the codes in
turn, round after round. Other work may share the cores: speeds (million discs times steps a second)
are those of the median CPU time, a ratio is the median of those within a round. Ours includes all
upkeep of the triangulation. Compilation is not counted (it is cached).

    radii 0.45 to 0.55 mm, k 1000 N/m, k_t = 2/7 k, mu 0.3, g 9.81 m/s2, Δt 2e-6 s,
    damping 2621 1/s times the effective mass (restitution about 0.9), half of it tangentially

A disc has the mass of a sphere of density 2500 kg/m3, in all codes. Its moment of inertia is that
of a disc, m r²/2, in ours and in LIGGGHTS in two dimensions (both then move alike until chaos parts
them), that of a sphere, 2/5 m r², in YADE, which also damps all pairs like that of two mean discs.
A start from places and velocities has lost its tangential springs, so a bed breathes a little at
first, in all codes.

settling
    The loose start until it rests, 60 000 steps. Not by YADE, which would take ten minutes.
settled
    The bed, started again from places and velocities.
collapse
    The bed without its right wall, which flows; timed from 0.04 s on.
silo
    The bed over a slot of ten discs in its floor, timed from 0.04 s on; discs leave the box. Ours
    only: a floor with a slot is a mesh of triangles in LIGGGHTS.
cost
    Our time per disc and step against the number of discs, from 1000 steps after the start on.

--quick settles a fifth of the bed, puts five side by side, takes fewer steps and rounds, leaves
out YADE and 100 000 discs, and needs less than a minute (and half of one more where kernels are
still to be compiled); --full adds a million discs.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
from collections.abc import Callable
from dataclasses import dataclass, replace
from math import pi
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from time import perf_counter, process_time

import numpy as np

os.environ |= dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")

import grainmesh as gm

K, DAMPING, MU, G, DT = 1000.0, 2621.0, 0.3, 9.81, 2e-6
DENSITY, PITCH, HEIGHT = 2500.0, 1.15e-3, 0.13
#: Steps until a loose start rests, and until a bed whose wall was taken away flows.
SETTLE, FLOW = 60_000, 20_000
#: Width of the slot of the silo [m].
SLOT = 10e-3
#: YADE fills its lists first; these steps are not timed.
YADE_BEFORE = 100
#: The bed of 10 000 discs as LIGGGHTS 3.8 left it once: kinetic energy per disc [J], height below
#: which 99 % of the centres lie [m], contacts per disc.
REFERENCE = 3.5e-10, 83.6e-3, 3.1
#: Most discs that are timed more than once in `costs`.
MOST = 200_000


@dataclass(frozen=True)
class Bed:
    """Discs between walls at x = 0 and x = width and above the floor y = 0; SI."""

    width: float
    x: np.ndarray
    velocity: np.ndarray
    spin: np.ndarray
    radius: np.ndarray

    def __len__(self) -> int:
        return len(self.x)

    @property
    def density(self) -> np.ndarray:
        """Density of discs, per unit depth, that gives them the mass of spheres."""
        return DENSITY * 4.0 / 3.0 * self.radius

    @property
    def kinetic(self) -> float:
        """Kinetic energy per disc [J]."""
        mass = self.density * pi * self.radius**2
        return float((0.5 * mass * (self.velocity**2).sum(axis=1)).mean())


@dataclass(frozen=True)
class Run:
    """Wall and CPU seconds of the steps, the bed after them, contacts per disc; of ours, upkeep."""

    seconds: float
    cpu: float
    end: Bed
    contacts: float
    share: float = np.nan
    flips: float = np.nan
    upkeeps: float = np.nan


@dataclass(frozen=True)
class Row:
    """The runs of one code on one case, one a round."""

    case: str
    code: str
    discs: int
    steps: int
    runs: list[Run]


def loose(columns: int, rows: int) -> Bed:
    """Discs on a jittered square lattice, each with some velocity."""
    rng = np.random.default_rng(1)
    i, j = np.divmod(np.arange(columns * rows), rows)
    x = PITCH * (np.stack([i, j], axis=1) + 0.5)
    x += rng.uniform(-2e-5, 2e-5, x.shape)
    velocity, radius = rng.uniform(-0.05, 0.05, x.shape), rng.uniform(0.45e-3, 0.55e-3, len(x))
    return Bed(columns * PITCH, x, velocity, np.zeros(len(x)), radius)


def tiled(bed: Bed, copies: int) -> Bed:
    """The same bed several times side by side."""
    shift = np.repeat(np.arange(copies) * bed.width, len(bed))
    x = np.tile(bed.x, (copies, 1)) + np.stack([shift, 0.0 * shift], axis=1)
    return Bed(
        copies * bed.width, x, np.tile(bed.velocity, (copies, 1)),
        np.tile(bed.spin, copies), np.tile(bed.radius, copies),
    )  # fmt: skip


# --- the codes ----------------------------------------------------------------------------------


def ours(bed: Bed, steps: int, before: int = 0, slot: float = 0.0) -> Run:
    """Ours, from the state of a bed; with a slot [m] in the middle of the floor, if any."""
    contact = gm.Contact(
        K, damping=DAMPING, friction=MU, tangential=2.0 / 7.0, tangential_damping=0.5
    )
    model = gm.Model(gm.Box(bed.width, HEIGHT), contact, (0.0, -G), open=("top",), dt=DT)
    if slot:
        a, b = 0.5 * (bed.width - slot), 0.5 * (bed.width + slot)
        floor = gm.Wall((0.0, 0.0), (a, 0.0)), gm.Wall((b, 0.0), (bed.width, 0.0))
        model = replace(model, walls=floor, open=("bottom", "top"), escape="remove")
    particles = gm.Particles(bed.x, 2.0 * bed.radius, bed.density)
    simulation = gm.Simulation(model, particles, bed.velocity, bed.spin)
    if before:
        simulation.run(until=before * DT)
    flips, upkeeps = simulation.measure()["flips"], simulation.upkeeps
    spent = dict(simulation.seconds)
    start = perf_counter(), process_time()
    simulation.run(until=(before + steps) * DT)
    seconds, cpu = perf_counter() - start[0], process_time() - start[1]
    particles = simulation.particles
    end = Bed(bed.width, simulation.x, simulation.velocity, simulation.spin, particles.radius)
    return Run(
        seconds,
        cpu,
        end,
        2.0 * len(simulation.contacts) / len(end),
        (simulation.seconds["upkeep"] - spent["upkeep"]) / seconds,
        (simulation.measure()["flips"] - flips) / steps,
        (simulation.upkeeps - upkeeps) / steps,
    )


LIGGGHTS = """
units si
dimension 2
boundary f f p
atom_style granular
atom_modify map array
communicate single vel yes
newton off
read_data bed.data
neighbor 0.0002 bin
neigh_modify every 1 delay 0 check yes

fix stiffness all property/global kn peratomtypepair 1 {K}
fix shear all property/global kt peratomtypepair 1 {KT}
fix damping all property/global gamman peratomtypepair 1 {DAMPING}
fix sheardamping all property/global gammat peratomtypepair 1 {SHEAR}
fix friction all property/global coefficientFriction peratomtypepair 1 {MU}
pair_style gran model hooke/stiffness tangential history
pair_coeff * *
fix left all wall/gran model hooke/stiffness tangential history primitive type 1 xplane 0.0
fix right all wall/gran model hooke/stiffness tangential history primitive type 1 xplane {width}
fix floor all wall/gran model hooke/stiffness tangential history primitive type 1 yplane 0.0
fix weight all gravity {G} vector 0.0 -1.0 0.0
fix motion all nve/sphere
fix plane all enforce2d
timestep {DT}

compute touching all contact/atom
thermo_style custom step atoms
thermo {steps}
thermo_modify lost error
shell "cat /proc/$PPID/stat >before"
run {steps}
shell "cat /proc/$PPID/stat >after"
write_dump all custom bed.dump id x y vx vy omegaz c_touching modify sort id format {format}
"""


def liggghts(bed: Bed, steps: int) -> Run:
    """LIGGGHTS, from the state of a bed; its discs are spheres that stay in the plane."""
    n = len(bed)
    number, flat = np.arange(1, n + 1), np.zeros(n)
    # Asked for two dimensions it takes density times pi r² for the mass, as we do.
    atoms = np.c_[number, flat + 1, 2.0 * bed.radius, bed.density, bed.x, flat]
    speeds = np.c_[number, bed.velocity, flat, flat, flat, bed.spin]
    names = {
        "K": K, "KT": K * 2.0 / 7.0, "DAMPING": DAMPING, "SHEAR": DAMPING / 2.0, "MU": MU, "G": G,
        "DT": DT, "width": repr(bed.width), "steps": steps,
        "format": '"%d' + 6 * " %.12g" + '"',
    }  # fmt: skip
    with TemporaryDirectory() as folder:
        with open(f"{folder}/bed.data", "w") as file:
            file.write(f"a bed of discs\n\n{n} atoms\n1 atom types\n\n0 {bed.width!r} xlo xhi\n")
            file.write(f"0 {HEIGHT} ylo yhi\n-0.001 0.001 zlo zhi\n\nAtoms\n\n")
            np.savetxt(file, atoms, "%d %d" + 5 * " %.12g")
            file.write("\nVelocities\n\n")
            np.savetxt(file, speeds, "%d" + 6 * " %.12g")
        Path(folder, "in.bed").write_text(LIGGGHTS.format(**names))
        said = told(["liggghts", "-in", "in.bed"], folder)
        found = re.search(r"Loop time of (\S+) on 1 procs", said)
        if not found:
            raise SystemExit(f"liggghts did not tell its time:\n{said[-2000:]}")
        rows = np.loadtxt(f"{folder}/bed.dump", skiprows=9)
        # Ticks of user and system time, counted from the name of the program.
        then, now = (
            Path(folder, f).read_text().split(")")[-1].split() for f in ("before", "after")
        )
        ticks = sum(int(now[k]) - int(then[k]) for k in (11, 12))
    x, velocity, spin, touching = np.split(rows[:, 1:], [2, 4, 5], axis=1)
    end = replace(bed, x=x, velocity=velocity, spin=spin[:, 0])
    return Run(float(found[1]), ticks / os.sysconf("SC_CLK_TCK"), end, float(touching.mean()))


YADE = """
import numpy, time
width, rows = {width}, numpy.load("bed.npy")
half = {K}, {K} * 2 / 7, {c}, {c} / 2  # of a contact; two materials in series have a half of theirs
grain = O.materials.append(ViscElMat(
    density={DENSITY}, frictionAngle=numpy.arctan({MU}),
    kn=2 * half[0], ks=2 * half[1], cn=2 * half[2], cs=2 * half[3],
))
for x, y, u, v, w, r in rows:
    ball = O.bodies[O.bodies.append(sphere((x, y, 0), r, material=grain))]
    ball.state.blockedDOFs = "zXY"
    ball.state.vel, ball.state.angVel = (u, v, 0), (0, 0, w)
for place, axis in ((0, 0), (width, 0), (0, 1)):
    O.bodies.append(wall(float(place), axis, material=grain))
O.engines = [
    ForceResetter(),
    InsertionSortCollider([Bo1_Sphere_Aabb(), Bo1_Wall_Aabb()], verletDist=1e-4),
    InteractionLoop(
        [Ig2_Sphere_Sphere_ScGeom(), Ig2_Wall_Sphere_ScGeom()],
        [Ip2_ViscElMat_ViscElMat_ViscElPhys()],
        [Law2_ScGeom_ViscElPhys_Basic()],
    ),
    NewtonIntegrator(gravity=(0, -{G}, 0), damping=0),
]
O.dt = {DT}
O.run({before}, True)
start = time.perf_counter(), time.process_time()
O.run({steps}, True)
print("cpu", time.process_time() - start[1])
print("seconds", time.perf_counter() - start[0])
real = [i for i in O.interactions if i.isReal]
print("stiffness", real[0].phys.kn)
pairs = sum(1 for i in real if max(i.id1, i.id2) < len(rows))
print("contacts", 2 * pairs / len(rows))
ends = [O.bodies[i].state for i in range(len(rows))]
numpy.save("end.npy", [(s.pos[0], s.pos[1], s.vel[0], s.vel[1], s.angVel[2]) for s in ends])
"""


def yade(bed: Bed, steps: int) -> Run:
    """YADE, from the state of a bed; its discs are spheres that stay in the plane."""
    mean = DENSITY * 4.0 / 3.0 * pi * 0.5e-3**3
    names = {
        "width": bed.width, "K": K, "c": 0.5 * mean * DAMPING, "DENSITY": DENSITY, "MU": MU, "G": G,
        "DT": DT, "before": YADE_BEFORE, "steps": steps,
    }  # fmt: skip
    with TemporaryDirectory() as folder:
        np.save(f"{folder}/bed.npy", np.c_[bed.x, bed.velocity, bed.spin, bed.radius])
        Path(folder, "bed.py").write_text(YADE.format(**names))
        said = told(["yade", "-j1", "-n", "-x", "bed.py"], folder)
        if "seconds" not in said:
            raise SystemExit(f"yade did not tell its time:\n{said[-2000:]}")
        x, velocity, spin = np.split(np.load(f"{folder}/end.npy"), [2, 4], axis=1)
    value = dict(re.findall(r"^(seconds|cpu|stiffness|contacts) (\S+)", said, re.MULTILINE))
    if abs(float(value["stiffness"]) / K - 1.0) > 1e-9:
        raise SystemExit(f"yade took a stiffness of {value['stiffness']} N/m, not {K:g}")
    end = replace(bed, x=x, velocity=velocity, spin=spin[:, 0])
    return Run(float(value["seconds"]), float(value["cpu"]), end, float(value["contacts"]))


def told(command: list[str], folder: str) -> str:
    """What a program wrote, run in a folder."""
    about = {"cwd": folder, "capture_output": True, "text": True, "stdin": subprocess.DEVNULL}
    done = subprocess.run(command, check=False, **about)
    return str(done.stdout + done.stderr)


CODES: dict[str, Callable[[Bed, int], Run]] = {
    "grainmesh": ours,
    "LIGGGHTS": liggghts,
    "YADE": yade,
}


# --- what is measured ---------------------------------------------------------------------------


def race(case: str, bed: Bed, rounds: int, **steps: int) -> list[Row]:
    """All codes named, so many steps each, in turn; those not installed get an empty row.

    YADE runs in the first round only, or it would take most of the time.
    """
    rows = [Row(case, code, len(bed), count, []) for code, count in steps.items()]
    there = [row for row in rows if row.code == "grainmesh" or shutil.which(row.code.lower())]
    for k in range(rounds):
        for row in there:
            if k == 0 or row.code != "YADE":
                row.runs.append(CODES[row.code](bed, row.steps))
    return rows


def costs(beds: list[Bed], rounds: int, steps: int) -> list[Row]:
    """Ours on beds of several sizes, all as long after their start."""
    rows = [Row("cost", "grainmesh", len(bed), steps, []) for bed in beds]
    for k in range(rounds):
        for row, bed in zip(rows, beds, strict=True):
            if k == 0 or row.discs <= MOST:
                row.runs.append(ours(bed, steps, before=1000))
    return rows


def show(rows: list[Row]) -> None:
    """Print the rows of a case."""
    other = next((row for row in rows if row.code == "LIGGGHTS" and row.runs), None)
    for row in rows:
        head = f"{row.case:<9}{row.code:<10}{row.discs:>8}{row.steps:>7}"
        if not row.runs:
            print(f"{head}  not installed")
            continue
        each = [run.cpu / (row.discs * row.steps) for run in row.runs]
        ratio = upkeep = ""
        if other and row is not other:
            peers = [run.cpu / (other.discs * other.steps) for run in other.runs]
            ratio = f"{median(b / a for a, b in zip(each, peers, strict=False)):.2f}"
        if row.code == "grainmesh":
            names = "share", "flips", "upkeeps"
            share, flips, often = (median(getattr(run, n) for run in row.runs) for n in names)
            every = f"{1.0 / often:.0f}" if often else "none"
            upkeep = f"{share:9.0%}{flips:12.2f}{every:>14}"
        print(
            f"{head}{median(run.seconds for run in row.runs):9.2f}"
            f"{median(run.cpu for run in row.runs):8.2f}{1e-6 / median(each):7.1f}"
            f"{1e9 * median(each):8.1f}{ratio:>12}{upkeep}",
            flush=True,
        )


def physics(rows: list[Row]) -> None:
    """Print what the bed looks like at the end of settling."""
    values = [
        (row.code, run.end.kinetic, float(np.quantile(run.end.x[:, 1], 0.99)), run.contacts)
        for row in rows
        for run in row.runs[:1]
    ]
    title = f"bed at rest, {rows[0].discs} discs"
    print(f"\n{title:<34}{'kinetic nJ/disc':>16}{'99 % below mm':>15}{'contacts/disc':>15}")
    for code, kinetic, height, contacts in [("LIGGGHTS 3.8, 10 000, once", *REFERENCE), *values]:
        print(f"{code:<34}{1e9 * kinetic:16.3f}{1e3 * height:15.1f}{contacts:15.2f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    group = parser.add_mutually_exclusive_group()
    group.add_argument("--quick", action="store_true", help="below a minute: 10 000 discs at most")
    group.add_argument("--full", action="store_true", help="a million discs too")
    args = parser.parse_args()
    quick = args.quick
    print(f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f} at the start")
    for slot in (0.0, SLOT):
        ours(loose(20, 5), 2000, slot=slot)  # compiles
    print(
        f"{'case':<9}{'code':<10}{'discs':>8}{'steps':>7}{'s':>9}{'CPU s':>8}{'M/s':>7}"
        f"{'ns':>8}{'x LIGGGHTS':>12}{'upkeep':>9}{'flips/step':>12}{'steps/upkeep':>14}"
    )

    rounds = 2 if quick else 3
    start = loose(20 if quick else 100, 100)
    settling = race("settling", start, 1 if quick else 2, grainmesh=SETTLE, LIGGGHTS=SETTLE)
    show(settling)
    one = settling[0].runs[0].end
    bed = tiled(one, 5) if quick else one
    few = 2000 if quick else 5000
    pair = {"grainmesh": few, "LIGGGHTS": few}
    show(race("settled", bed, rounds, **pair, **({} if quick else {"YADE": 500})))
    beds = [ours(loose(32, 32), SETTLE).end, bed]
    if not quick:
        beds.append(tiled(bed, 10))
        show(race("settled", beds[-1], rounds, grainmesh=1000, LIGGGHTS=1000, YADE=50))
    if args.full:
        beds.append(tiled(bed, 100))
    flowing = ours(replace(one, width=3.0 * one.width), FLOW).end
    show(race("collapse", flowing, rounds, **pair))
    show([Row("silo", "grainmesh", len(one), few, [ours(one, few, FLOW, SLOT)])])
    show(costs(beds, rounds, 2000))
    physics(settling)
    print(f"\nload {os.getloadavg()[0]:.1f} at the end")


if __name__ == "__main__":
    main()
