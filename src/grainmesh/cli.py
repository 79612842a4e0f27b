"""The command line: verbs over files, and the only module that prints.

Exit status: 0 done; 1 a run that cannot go on, or a case that is off; 2 bad input, with one plain
line on stderr; 130 or 143 interrupted. Results go to stdout; progress, warnings and errors to
stderr. Lengths on the command line are metres, as in Python: only the columns of a file have a unit
of their own.

What takes long to load is imported by the verb that needs it, so that ``--help`` is quick.
"""

from __future__ import annotations

import json
import os
import shlex
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from io import TextIOWrapper
from math import isnan
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, cast, get_args

import typer
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from grainmesh import __version__
from grainmesh.closures import LAWS
from grainmesh.errors import InputError, RunError

if TYPE_CHECKING:
    from grainmesh.domain import Box
    from grainmesh.particles import Particles
    from grainmesh.permeability import Permeability

#: The error of the command-line parser, wherever this version of typer takes it from.
ParserError: type[Exception] = typer.BadParameter.__mro__[2]

#: Discs thicker than this [m] are rare enough to ask for the unit of the file.
LARGE = 2.0
FILES = ("permeability.json", "permeability.csv", "permeability.png")
FOUND = ("fibres.csv", "fibres.png")
FIGURES = ("fig1", "fig2", "fig3")
STARTERS = ("settling", "sedimentation", "fluidised-bed", "filtration", "permeability")

app = typer.Typer(
    name="grainmesh",
    help="Flow through and around many particles: the grains are the mesh.",
    add_completion=False,
    rich_markup_mode=None,
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line.

    Parameters
    ----------
    arguments : sequence of str, optional
        By default those of the process.

    Returns
    -------
    int
        The exit status.
    """
    for stream in (sys.stdout, sys.stderr):  # a terminal that knows no Greek gets question marks
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="replace")
    command = typer.main.get_command(app)
    try:
        with command.make_context(
            "grainmesh", list(sys.argv[1:] if arguments is None else arguments)
        ) as context:
            command.invoke(context)
            sys.stdout.flush()
        return 0
    except typer.Exit as request:
        return int(request.exit_code)
    except ParserError as error:
        where = getattr(error, "ctx", None)
        path = where.command_path if where else "grainmesh"
        text = error.format_message()  # type: ignore[attr-defined]
        return _fail(f"{text.rstrip('.')}; see {path} --help")
    except InputError as error:
        return _fail(str(error))
    except RunError as error:
        _fail(str(error))
        return 1
    except BrokenPipeError:  # the reader has gone, as in `| head`: nobody is left to tell
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except OSError as error:
        what = f"{error.filename}: {error.strerror}" if error.filename else str(error)
        return _fail(f"{what}; check the path and the space left there")
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return 130


def _fail(message: str) -> int:
    print("error: " + " ".join(message.split()), file=sys.stderr)
    return 2


@app.callback(invoke_without_command=True)
def grainmesh(
    context: typer.Context,
    version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False,
) -> None:
    """Flow through and around many particles: the grains are the mesh."""
    if version:
        print(f"grainmesh {__version__}")
    elif context.invoked_subcommand is None:
        print(context.get_help())


@app.command()
def new(
    name: Annotated[str, typer.Argument(help="Name of the case: NAME.toml is written.")],
    starter: Annotated[
        str,
        typer.Option(help=f"What to begin with: {', '.join(STARTERS)}."),
    ] = STARTERS[0],
) -> None:
    """Write a commented case file to begin with."""
    from grainmesh import case, report

    text = case.starter(starter)
    path = Path(name if name.endswith(".toml") else f"{name}.toml")
    if not path.stem.strip(".") or path.stem == ".toml":
        raise InputError(f"name '{name}' must be that of a file")
    report.prove_writable(path.parent, [path.name])
    if path.exists():
        raise InputError(f"{path}: is there already; choose another name or remove it")

    def as_text(to: Path) -> None:
        to.write_text(text, encoding="utf-8")

    report.write(path.parent, {path.name: as_text})
    file, folder = shlex.quote(str(path)), shlex.quote(str(path.with_suffix("")))
    print(f"{path}\n  grainmesh check {file}\n  grainmesh run {file} --out {folder}")


@app.command()
def check(
    file: Annotated[Path, typer.Argument(metavar="CASE", help="Case file (TOML).")],
    changes: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="Change a key, as fluid.viscosity='2 cP'."),
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print one JSON object in place of the table.")
    ] = False,
) -> None:
    """Arrange and mesh the particles of a case, run nothing: what regime, what cost, what is off.

    Exit status 1 if something is off; the reasons are on stderr.
    """
    from grainmesh import case
    from grainmesh.preview import preview

    with _progress() as tell:
        tell("arranging")
        found = preview(case.read(file, changes or ()))
    if as_json:
        print(json.dumps(found.to_dict(), indent=2, allow_nan=False))
    else:
        table = Table(box=SIMPLE_HEAD)
        for title in ("", "value", "unit", ""):
            table.add_column(title, justify="right" if title == "value" else "left")
        for number in found.numbers:
            table.add_row(number.name, f"{number.value:.4g}", number.unit, number.words)
        Console().print(table)
    for reason in found.reasons:
        print("off: " + " ".join(reason.split()), file=sys.stderr)
    if found.reasons:
        raise typer.Exit(1)


@app.command()
def run(
    file: Annotated[Path, typer.Argument(metavar="CASE", help="Case file (TOML).")],
    out: Annotated[Path, typer.Option(help="Folder for all that the run leaves.")],
    changes: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="Change a key, as fluid.viscosity='2 cP'."),
    ] = None,
    until: Annotated[
        str | None, typer.Option(help='Time to reach, not run.until: 2, or "20 ms".')
    ] = None,
    quiet: Annotated[bool, typer.Option("--quiet", help="Show no progress.")] = False,
    log: Annotated[Path | None, typer.Option(help="Log file, not run.log in the folder.")] = None,
) -> None:
    """Run a case. Ctrl-C finishes the step and saves; `grainmesh resume` goes on from there."""
    from grainmesh import case, report
    from grainmesh.preview import preview
    from grainmesh.record import prove_vacant, record

    changes = [*(changes or ()), *([] if until is None else [f"run.until={_seconds(until)!r}"])]
    found = case.read(file, changes)
    if found.run is None:
        report.prove_writable(out, FILES)
        with _progress() as tell, _warned():
            results = found.solve(tell)
            _write(out, *found.arrangement()[:2], results)
        _show(file, results, ())
        return
    about = found.run
    prove_vacant(out)
    with _warned(), _stopped():
        with _progress() as tell:
            tell("" if quiet else "arranging the particles")
            begun = found.simulation()
        ahead = preview(found, begun)
        for reason in ahead.reasons:
            warnings.warn(reason, stacklevel=1)
        if not quiet:
            cost = {number.name: number.value for number in ahead.numbers}
            print(
                f"estimate: {cost['memory']:.0f} MiB, {cost['run time']:.2g} s on one core",
                file=sys.stderr,
            )
        plan = about.until, about.every, about.frames, about.cuts, about.probes
        record(begun, out, *plan, shown=not quiet, log=log)
    _report(out)
    print(out)


@app.command()
def resume(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of a run.")],
    until: Annotated[str | None, typer.Option(help='Another time to reach: 2, or "20 ms".')] = None,
    quiet: Annotated[bool, typer.Option("--quiet", help="Show no progress.")] = False,
    log: Annotated[Path | None, typer.Option(help="Log file, not run.log in the folder.")] = None,
) -> None:
    """Go on with a run that was stopped or killed, as if it had not been."""
    from grainmesh import record

    with _warned(), _stopped():
        end = None if until is None else _seconds(until)
        record.resume(folder, end, shown=not quiet, log=log)
    _report(folder)
    print(folder)


@app.command()
def schema() -> None:
    """Print the JSON schema of case files, for editors that complete and check TOML."""
    from grainmesh import case

    print(json.dumps(case.schema(), indent=2))


@app.command()
def permeability(
    file: Annotated[
        Path,
        typer.Argument(help="List of discs: columns x, y and one of d, r (any case, any order)."),
    ],
    diameter: Annotated[
        float | None, typer.Option(help="One diameter [m] for all discs, in place of the column.")
    ] = None,
    unit: Annotated[float, typer.Option(help="Metres per unit of the columns of the file.")] = 1.0,
    width: Annotated[
        float | None, typer.Option(help="Width of the box [m]; default: bounding box of the discs.")
    ] = None,
    height: Annotated[float | None, typer.Option(help="Height of the box [m].")] = None,
    window: Annotated[
        str | None,
        typer.Option(
            metavar="X0,Y0,X1,Y1", help="Take this rectangle [m] as the box; implies --crop."
        ),
    ] = None,
    crop: Annotated[
        bool, typer.Option("--crop", help="Drop discs wholly outside the box.")
    ] = False,
    periodic: Annotated[
        bool, typer.Option("--periodic", help="Periodic box; needs its size or --window.")
    ] = False,
    walls: Annotated[
        str | None,
        typer.Option(help="Sides along the flow: symmetry (default) or no-slip, a channel."),
    ] = None,
    method: Annotated[
        str, typer.Option(help="One or more of resolved, mesoscale, microstructure.")
    ] = "resolved,mesoscale,microstructure",
    law: Annotated[
        str,
        typer.Option(help=f"Drag law of mesoscale and microstructure: {', '.join(LAWS)}."),
    ] = "microstructural",
    tol: Annotated[float, typer.Option(help="Relative tolerance of resolved.")] = 1e-3,
    order: Annotated[
        int | None,
        typer.Option(
            help="Order of the velocity; default: as tol needs (resolved), 2 (mesoscale).",
            min=1,
            max=8,
        ),
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print one JSON object in place of the table.")
    ] = False,
    out: Annotated[
        Path | None, typer.Option(help=f"Folder to write {', '.join(FILES)} to.")
    ] = None,
) -> None:
    """Permeability of a box of discs, by up to three methods.

    All lengths given here are metres; only the file's columns are multiplied by --unit. A pressure
    drop along x gives the first column of the tensor, along y the second. Of a disc that the edge
    of the box cuts, the part inside counts, in every method; discs wholly outside are refused
    unless --crop drops them.
    """
    import numpy as np

    from grainmesh import arrange, report
    from grainmesh.permeability import METHODS
    from grainmesh.permeability import permeability as solve
    from grainmesh.resolved import Walls

    methods = _methods(method)
    if law not in LAWS:
        raise InputError(f"law '{law}' unknown: use one of {', '.join(LAWS)}")
    if walls not in (None, *get_args(Walls)):
        raise InputError(f"walls '{walls}' unknown: use {' or '.join(get_args(Walls))}")
    if not 0.0 < tol < 1.0:
        raise InputError(f"tol {tol:g} must lie between 0 and 1")
    if periodic and walls is not None:
        raise InputError("a periodic box has no walls: drop --walls or --periodic")
    if order is not None and order < 3 and "resolved" in methods:
        raise InputError(
            f"order {order} is too low for resolved, which compares with the order below: "
            "use 3 or more, or leave it out"
        )
    if out is not None:
        report.prove_writable(out, FILES)
    box, particles = arrange.from_csv(
        file,
        unit=unit,
        diameter=diameter,
        width=width,
        height=height,
        window=None if window is None else _window(window),
        periodic=periodic,
        crop=crop,
    )
    extent = np.ptp(particles.x, axis=0) + particles.diameter.max()
    if (extent < 1e-3 * box.size).all():  # 40 for 40e-6 would ask for a mesh without end
        raise InputError(
            f"{file}: the discs span {extent.max():g} m only of a box {box.width:g} m wide: "
            "--width, --height and --window are metres"
        )
    found: dict[str, Permeability] = {}
    told: list[str] = []
    if unit == 1.0 and particles.mean_diameter > LARGE:
        told.append(
            f"{file}: the mean diameter is {particles.mean_diameter:g} m; if the columns are not "
            "metres, say --unit (1e-6 for micrometres)"
        )
    with _progress() as tell:
        # The cheapest first: what can fail fails before the long work.
        for name in sorted(methods, key=METHODS.index, reverse=True):
            with warnings.catch_warnings(record=True) as caught:
                warnings.simplefilter("always")
                try:
                    result = solve(
                        box,
                        particles,
                        name,
                        walls=cast(Walls, walls or "symmetry"),
                        law=LAWS[law],
                        tol=tol,
                        order=order,
                        progress=_named(tell, name),
                    )
                except InputError as error:
                    raise InputError(_with_file(file, str(error), crop or bool(window))) from None
            said = [str(w.message) for w in caught]
            told += said
            notes = tuple(dict.fromkeys([*result.notes, *said]))
            found[name] = replace(result, notes=notes)
        results = [found[name] for name in methods]
        if out is not None:
            tell("writing")
            _write(out, box, particles, results)
    for text in dict.fromkeys(told):
        print("warning: " + " ".join(text.split()), file=sys.stderr)
    if as_json:
        print(json.dumps(report.as_dict(results), indent=2, allow_nan=False))
    else:
        _show(file, results, told)


@app.command()
def fibres(
    image: Annotated[Path, typer.Argument(help="Micrograph or slice: PNG, TIFF, JPEG.")],
    diameter: Annotated[
        str,
        typer.Option(
            metavar="PIXELS", help="Diameter of the fibres, to some 30 %; or least,largest."
        ),
    ],
    out: Annotated[Path, typer.Option(help=f"Folder to write {' and '.join(FOUND)} to.")],
    pixel: Annotated[
        float | None, typer.Option(help="Size of a pixel [m]: the list is then in metres.")
    ] = None,
    bright: Annotated[
        bool | None,
        typer.Option("--bright/--dark", help="Fibres against ground; default: found out."),
    ] = None,
    score: Annotated[float, typer.Option(help="Least score of a fibre, from 0 to 1.")] = 0.5,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Find fibres in an image: a list that permeability reads, and a picture for checking."""
    from grainmesh import fibres as discs
    from grainmesh import report

    if pixel is not None and not 0.0 < pixel < 1.0:
        raise InputError(f"pixel {pixel:g} must be its size in metres, as 0.5e-6")
    report.prove_writable(out, FOUND)
    try:
        wanted = [float(part) for part in diameter.split(",")]
    except ValueError:
        wanted = []
    if len(wanted) not in (1, 2):
        raise InputError(f"diameter '{diameter}' must be pixels: one number, or least,largest")
    with _progress() as tell:
        tell("looking for fibres")
        found = discs.find(
            image,
            wanted[0] if len(wanted) == 1 else (wanted[0], wanted[1]),
            bright=bright,
            score=score,
        )
        tell("writing")
        _headless()
        scale, unit = (1.0, "pixels") if pixel is None else (pixel, "m")
        width, height = (side * scale for side in found.size)
        rows = [
            {"x": x * scale, "y": y * scale, "d": 2.0 * r * scale, "score": s}
            for (x, y), r, s in zip(
                found.x.tolist(), found.radius.tolist(), found.score.tolist(), strict=True
            )
        ]
        comments = [
            f"fibres of {image.name}, by grainmesh {__version__}; lengths in {unit}",
            f"x and y upwards from the lower left corner of the image, {width:g} x {height:g}",
        ]
        report.write(
            out,
            {
                FOUND[0]: lambda path: report.write_csv(path, rows, comments),
                FOUND[1]: lambda path: discs.save_overlay(discs.read(image), found, path),
            },
        )
    if as_json:
        print(json.dumps(found.to_dict(), indent=2, allow_nan=False))
        return
    print(f"{image}: {found!r}")
    print(f"{out / FOUND[0]}  in {unit}\n{out / FOUND[1]}  look whether all is well")
    if pixel is not None:
        print(f"grainmesh permeability {out / FOUND[0]} --window 0,0,{width:g},{height:g}")


@app.command()
def report(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of a run.")],
) -> None:
    """Write report.html of a run anew: one page with pictures, histories, times, what to cite."""
    print(_report(folder))


@app.command()
def show(
    folder: Annotated[
        Path, typer.Argument(metavar="DIR", help="Folder of a run, or of a permeability.")
    ],
    port: Annotated[
        int, typer.Option(help="Port on this machine; default: a free one.", min=0, max=65535)
    ] = 0,
) -> None:
    """Look at a run in the browser: prints an address to open, and serves it until Ctrl-C."""
    picture = folder / FILES[-1]
    if picture.is_file():
        print(picture.resolve().as_uri())
        return
    from grainmesh import viewer

    viewer.serve(folder, port, ready=lambda address: print(address, flush=True))


@app.command()
def cite(
    what: Annotated[
        Path | None, typer.Argument(metavar="[CASE or DIR]", help="Default: grainmesh itself.")
    ] = None,
) -> None:
    """Print the BibTeX of grainmesh, and of the methods and laws of a case or a run."""
    from grainmesh import cite as sources

    print(sources.bibtex([] if what is None else _used(what)), end="")


def _report(folder: Path) -> Path:
    _headless()
    from grainmesh import page

    with _progress() as tell:
        tell("drawing the report")
        return page.write(folder)


def _used(what: Path) -> list[str]:
    """Methods and laws of a case, a run or the results of a permeability."""
    from grainmesh import case, cite, page, simulation

    found = what / FILES[0]
    if found.is_file():
        try:
            results = json.loads(found.read_text(encoding="utf-8"))["results"]
            return [result["method"] for result in results]
        except (ValueError, KeyError, TypeError):
            raise InputError(f"{found}: damaged, or no results of grainmesh") from None
    if what.is_dir() and not (what / "case.toml").is_file():
        return page.used(simulation.resume(what).model)
    given = case.read(what / "case.toml" if what.is_dir() else what)
    if given.permeability is not None:
        return [*given.permeability.method, given.permeability.law]
    names = ["contacts", *(["flow", given.fluid.drag] if given.fluid else [])]
    return [name for name in names if name in cite.SOURCES]


@app.command()
def paper(
    figure: Annotated[str, typer.Argument(metavar="FIGURE", help="fig1, fig2 or fig3.")],
    out: Annotated[Path, typer.Option(help="Folder to write the picture and its numbers to.")],
    quick: Annotated[bool, typer.Option("--quick", help="Fewer samples, fewer discs.")] = False,
) -> None:
    """Make a figure of the paper again (Yazdchi, Srivastava, Luding 2013), with its numbers."""
    if figure not in FIGURES:
        raise InputError(f"figure '{figure}' unknown: use one of {', '.join(FIGURES)}")
    from grainmesh import report

    report.prove_writable(out, [f"{figure}.png", f"{figure}.csv"])
    with _progress() as tell, warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        tell("getting ready")
        _headless()
        from grainmesh import paper as figures

        getattr(figures, figure)(out, quick=quick, progress=tell)
    for text in dict.fromkeys(" ".join(str(w.message).split()) for w in caught):
        print("warning: " + text, file=sys.stderr)
    for name in (f"{figure}.png", f"{figure}.csv"):
        print(out / name)


def _named(tell: Callable[[str], None], method: str) -> Callable[[str], None]:
    return lambda text: tell(f"{method}: {text}")


def _methods(text: str) -> list[str]:
    from grainmesh.permeability import METHODS

    methods = list(dict.fromkeys(name.strip() for name in text.split(",")))
    for name in methods:
        if name not in METHODS:
            raise InputError(f"method '{name}' unknown: use one or more of {', '.join(METHODS)}")
    return methods


def _window(text: str) -> tuple[float, float, float, float]:
    try:
        x0, y0, x1, y1 = (float(part) for part in text.split(","))
    except ValueError:
        raise InputError(f"window '{text}' must be four numbers in metres: x0,y0,x1,y1") from None
    return x0, y0, x1, y1


def _with_file(file: Path, message: str, cropped: bool) -> str:
    """A message about the discs, with the file they came from."""
    if message.startswith("particle"):
        message += f" (particle 0 is the first row{' that is kept' if cropped else ''})"
    return f"{file}: {message}"


@contextmanager
def _progress() -> Iterator[Callable[[str], None]]:
    """A spinner on stderr with the words last told; nothing unless it is a terminal."""
    with Console(stderr=True).status("") as status:
        yield lambda text: status.update(text)


@contextmanager
def _warned() -> Iterator[None]:
    """Warnings on stderr as they come, one line each."""

    def show(message: Warning | str, *_: object) -> None:
        print("warning: " + " ".join(str(message).split()), file=sys.stderr)

    with warnings.catch_warnings():
        warnings.simplefilter("default")
        warnings.showwarning = show  # type: ignore[assignment]
        yield


def _seconds(until: str) -> float:
    """The option --until [s]."""
    from grainmesh.units import si

    value: float | str = until
    with suppress(ValueError):
        value = float(until)
    try:
        found = si(value, "s")
    except InputError as fault:
        raise InputError(f"--until: {fault}") from None
    if found <= 0.0:
        raise InputError(f"--until: {until} must be positive")
    return found


@contextmanager
def _stopped() -> Iterator[None]:
    """A run that was asked to stop: say so, and exit as signals do."""
    from grainmesh.record import Stopped

    try:
        yield
    except Stopped as stop:
        print(stop, file=sys.stderr)
        raise typer.Exit(128 + stop.signal) from None


def _headless() -> None:
    import matplotlib

    matplotlib.use("Agg")


def _write(out: Path, box: Box, particles: Particles, results: Sequence[Permeability]) -> None:
    _headless()
    from grainmesh import plot, report

    def as_json(path: Path) -> None:
        text = json.dumps(report.as_dict(results), indent=2, allow_nan=False)
        path.write_text(text + "\n", encoding="utf-8")

    def as_csv(path: Path) -> None:
        report.write_csv(path, report.rows(results), ["grainmesh permeability; SI units"])

    def as_png(path: Path) -> None:
        plot.save(plot.overview(box, particles, results), path)

    report.write(out, dict(zip(FILES, (as_json, as_csv, as_png), strict=True)))


def _show(file: Path, results: Sequence[Permeability], told: Sequence[str]) -> None:
    """The table on stdout, and the notes under it that were not told as warnings."""
    from grainmesh.permeability import percent

    first = results[0]
    print(
        f"{file}: {first.n} discs, mean diameter {first.diameter:.4g} m, "
        f"porosity {first.porosity:.4f}, gap {'-' if isnan(first.gap) else f'{first.gap:.4g}'}"
    )
    table = Table(box=SIMPLE_HEAD)  # fits 80 columns; the whole tensor is in --json
    for title in ("method", "K/d²", "error", "Kxx (m²)", "Kyy (m²)", "dofs", "seconds"):
        table.add_column(title, justify="left" if title == "method" else "right", no_wrap=True)
    for r in results:
        table.add_row(
            r.method,
            f"{r.normalised:.4g}",
            percent(r.error),
            *(f"{k:.3g}" for k in r.tensor.diagonal()),
            f"{r.dofs}",
            f"{r.seconds:.2g}",
        )
    Console().print(table)
    print("K/d² is that of the mean of Kxx and Kyy, d the mean diameter.")
    for r in results:
        for note in r.notes:
            if note not in told:
                print(f"{r.method}: {note}")
    if any(r.method != "resolved" for r in results):
        print("The error of mesoscale and microstructure is that of the law for its own medium.")


if __name__ == "__main__":
    sys.exit(main())
