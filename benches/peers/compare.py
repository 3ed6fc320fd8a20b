"""Ventricle beside other programs: the same work in turns within one run, processor time, one thread each, medians and ratios.

Called by `cargo bench --bench peers` (`make bench-peers`) with the path of that program, which is Ventricle's side, and of the file to
write. Prints the tables of docs/performance.md.
"""

import importlib.metadata
import json
import platform
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from statistics import median

import itk
import numpy as np
import SimpleITK as sitk
from scipy import ndimage
from skimage import feature

import field
import method

ROUNDS = 5
ITK_ITERATIONS = 200
EXPLICIT_STEPS = 1000
NUMBA, LIBRARIES = "Python, every loop by numba", "Python, Canny by scikit-image and solver by scipy"
PACKAGES = ["itk-filtering", "numba", "numpy", "pyamg", "scikit-image", "scipy", "SimpleITK"]


class Ventricle:
    """The process that answers for us; starting it is no part of any time."""

    def __init__(self, program):
        self.process = subprocess.Popen([program, "answer"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self.instructions = json.loads(self.process.stdout.readline())["instructions"]

    def ask(self, question):
        self.process.stdin.write(question + "\n")
        self.process.stdin.flush()
        answer = json.loads(self.process.stdout.readline())
        assert "error" not in answer, answer
        return answer

    def timed(self, question):
        def run():
            answer = self.ask(question)
            return answer["seconds"], answer

        return run

    def end(self):
        self.process.stdin.close()
        assert self.process.wait() == 0


def timed(work):
    """A contender in Python: seconds of processor time and what came of it."""

    def run():
        began = time.process_time()
        result = work()
        return time.process_time() - began, result

    return run


def in_turns(contenders, rounds=ROUNDS):
    """Every contender once to warm up (caches, compilation), then once a round; the last result of each."""
    results = {name: run()[1] for name, run in contenders.items()}
    seconds = {name: [] for name in contenders}
    for turn in range(rounds):
        for name, run in contenders.items():
            took, results[name] = run()
            seconds[name].append(took)
        print(f"  round {turn + 1} of {rounds}: " + ", ".join(f"{name} {of[-1]:.3f} s" for name, of in seconds.items()), file=sys.stderr)
    return seconds, results


def summary(seconds, ours):
    """Medians, and the ratio to ours within each round: its median, least and most."""
    rows = {}
    for name, of in seconds.items():
        ratios = [theirs / own for theirs, own in zip(of, seconds[ours])]
        rows[name] = {"seconds": of, "median_s": median(of), "ratio": median(ratios), "least": min(ratios), "most": max(ratios)}
    return rows


# Gradient vector flow.

VECTORS = itk.Image[itk.CovariantVector[itk.F, 3], 3]
SCALARS = itk.Image[itk.F, 3]


def itk_flow(gradients, mu, iterations):
    """ITK's filter on the gradients of some edge maps. It takes no heed of spacing: its Laplacian is that of unit voxels."""
    fields = []
    for image in gradients:
        gvf = itk.GradientVectorFlowImageFilter[VECTORS, VECTORS, itk.F].New()
        gvf.SetLaplacianFilter(itk.LaplacianImageFilter[SCALARS, SCALARS].New())
        gvf.SetInput(image)
        gvf.SetNoiseLevel(mu)
        gvf.SetIterationNum(iterations)
        gvf.Update()
        fields.append(gvf.GetOutput())
    return fields


def components(image):
    return list(np.moveaxis(itk.array_from_image(image), -1, 0))


def steps_to(problem, dt, tolerance, most=20000):
    """How many explicit steps reach a residual. Beyond `most` by the rate of the last 500, which is kind: the rate only falls."""
    run, stride = field.Explicit(problem, dt), 500
    last = None
    while run.steps < most:
        run.advance(stride)
        residual = problem.residual(run.field)
        if residual <= tolerance:
            # Within the stride the residual falls by a constant factor a step.
            return round(run.steps - stride * np.log(tolerance / residual) / np.log(last / residual)), True
        if not np.isfinite(residual):
            return None, False
        before, last = last, residual
    return round(run.steps + stride * np.log(residual / tolerance) / np.log(before / residual)), False


def flow_table(ours, told, maps):
    problems = [field.Problem(edges, told["spacing_mm"], told["mu"]) for edges in maps]
    laplacians = [field.laplacian(edges.shape, problem.weights) for edges, problem in zip(maps, problems)]
    tolerance = told["tolerance"]
    unit = [field.Problem(edges, (1.0, 1.0, 1.0), 1.0) for edges in maps]
    images = [itk.image_from_array(np.ascontiguousarray(np.stack(problem.gradient, axis=-1)), ttype=VECTORS) for problem in unit]
    # The least balance at which ITK's time step of 1 / (8 mu) is stable: b / (8 mu) + 12 / 8 < 2.
    stable_mu = float(max(np.max(problem.b) for problem in unit)) / 3.9

    # What ITK's iteration comes to, on unit voxels as it sees them.
    itk_course = {}
    for name, mu in (("paper's balance", told["mu"]), ("least stable balance", stable_mu)):
        its = [field.Problem(edges, (1.0, 1.0, 1.0), mu) for edges in maps]
        counts = (1, 5, 10) if mu < stable_mu else (10, 50, 100, ITK_ITERATIONS)
        itk_course[name] = {"mu": mu, "residual": {}}
        for count in counts:
            fields = [components(image) for image in itk_flow(images, mu, count)]
            itk_course[name]["residual"][count] = float(max(problem.residual(found) for problem, found in zip(its, fields)))
        own = [field.Explicit(problem, 1 / (8 * mu)) for problem in its]
        for run in own:
            run.advance(counts[-1])
        itk_course[name]["differs_from_our_explicit_steps"] = float(
            max(np.max(np.abs(a - b)) / np.max(np.abs(b)) for run, found in zip(own, fields) for a, b in zip(run.field, found))
        )
    needed = [steps_to(problem, 1 / (8 * stable_mu), tolerance) for problem in its]
    itk_course["least stable balance"]["iterations_to_tolerance"] = max(count for count, _ in needed)
    itk_course["least stable balance"]["extrapolated"] = not all(reached for _, reached in needed)

    explicit_needed = [steps_to(problem, field.stable_step(problem), tolerance) for problem in problems]

    def explicit_steps():
        for problem in problems:
            field.Explicit(problem, field.stable_step(problem)).advance(EXPLICIT_STEPS // 2)

    contenders = {
        "Ventricle": ours.timed("gvf"),
        "numba, conjugate gradients, f32": timed(lambda: [field.numba_cg(problem, tolerance) for problem in problems]),
        "scipy.sparse, conjugate gradients, f32": timed(lambda: [field.scipy_cg(*of, tolerance) for of in zip(problems, laplacians)]),
        "pyamg, CG with Ruge-Stüben": timed(lambda: [field.pyamg_cg(*of, tolerance) for of in zip(problems, laplacians)]),
        f"Ventricle, explicit, {EXPLICIT_STEPS // 2} steps": ours.timed(f"explicit {EXPLICIT_STEPS // 2}"),
        f"numba, explicit, {EXPLICIT_STEPS // 2} steps": timed(explicit_steps),
        f"ITK, {ITK_ITERATIONS} iterations": timed(lambda: itk_flow(images, stable_mu, ITK_ITERATIONS)),
    }
    seconds, results = in_turns(contenders)
    rows = summary(seconds, "Ventricle")
    rows["Ventricle"]["residual"] = results["Ventricle"]["residual"]
    for name in list(contenders)[1:4]:
        rows[name]["residual"] = float(max(problem.residual(found) for problem, (found, _) in zip(problems, results[name])))
        rows[name]["iterations"] = [count for _, counts in results[name] for count in counts]
    rows["Ventricle"]["iterations"] = results["Ventricle"]["iterations"]
    rows[f"ITK, {ITK_ITERATIONS} iterations"]["residual"] = itk_course["least stable balance"]["residual"][ITK_ITERATIONS]
    # What is too long to run in turns, from the time of a step and the number of steps.
    times = max(count for count, _ in explicit_needed) / (EXPLICIT_STEPS // 2)
    whole = {
        f"{by}, explicit, to 1e-4": (rows[f"{by}, explicit, {EXPLICIT_STEPS // 2} steps"], times) for by in ("Ventricle", "numba")
    } | {
        "ITK, to 1e-4": (rows[f"ITK, {ITK_ITERATIONS} iterations"], max(count for count, _ in needed) / ITK_ITERATIONS),
    }
    for name, (part, times) in whole.items():
        rows[name] = {key: part[key] * times for key in ("median_s", "ratio", "least", "most")} | {"calculated": True, "residual": tolerance}
    return {"rows": rows, "itk": itk_course, "explicit_steps_to_tolerance": max(count for count, _ in explicit_needed)}


# The preset and its pieces.


def paper_table(ours, told, gates):
    topology = method.Topology(told["level"])
    contenders = {
        "Ventricle": ours.timed("paper"),
        NUMBA: timed(lambda: method.reconstruct(gates, told, topology)),
        LIBRARIES: timed(lambda: method.reconstruct(gates, told, topology, by_libraries=True)),
    }
    seconds, results = in_turns(contenders)
    rows = summary(seconds, "Ventricle")
    for name, result in results.items():
        rows[name] |= {key: value for key, value in result.items() if key not in ("seconds", "clock_seconds")}
    return rows


def pieces_table(ours, told, gates):
    counts, spacing_mm, sigma = gates[0], told["spacing_mm"], told["sigma"]
    sigma_mm = sigma * spacing_mm[2]
    in_voxels = [sigma_mm / spacing for spacing in spacing_mm]
    image = sitk.GetImageFromArray(counts)
    image.SetSpacing(spacing_mm[::-1])
    slices = [sitk.GetImageFromArray(of) for of in counts]

    def strongest(of):
        return float(np.max(ndimage.gaussian_gradient_magnitude(of, sigma)))

    # Thresholds of each slice, found before: a Canny operator of others takes them as counts.
    limits = [(told["low"] * strongest(of), told["high"] * strongest(of)) for of in counts]
    whole = float(np.max(ndimage.gaussian_gradient_magnitude(counts, in_voxels))) / sigma_mm * sigma
    return {
        "Gradient of the counts after a Gaussian of 5.2 mm, volume": summary(in_turns({
            "Ventricle": ours.timed("gradient"),
            "SimpleITK": timed(lambda: sitk.GradientMagnitudeRecursiveGaussian(image, sigma_mm)),
            "scipy": timed(lambda: ndimage.gaussian_gradient_magnitude(counts, in_voxels)),
        })[0], "Ventricle"),
        "Canny edges of 24 slices": summary(in_turns({
            "Ventricle": ours.timed("canny slice"),
            "scikit-image": timed(lambda: [feature.canny(of, sigma, low, high) for of, (low, high) in zip(counts, limits)]),
            "SimpleITK": timed(lambda: [sitk.CannyEdgeDetection(of, low, high, [sigma**2] * 2) for of, (low, high) in zip(slices, limits)]),
        })[0], "Ventricle"),
        "Canny edges in the volume": summary(in_turns({
            "Ventricle": ours.timed("canny volume"),
            "SimpleITK": timed(lambda: sitk.CannyEdgeDetection(image, told["low"] * whole, told["high"] * whole, [sigma_mm**2] * 3)),
        })[0], "Ventricle"),
    }  # fmt: skip


# What is written.


def machine(ours):
    cpu = next((line.split(":", 1)[1].strip() for line in open("/proc/cpuinfo") if line.startswith("model name")), platform.machine())
    rustc = subprocess.run(["rustc", "--version"], capture_output=True, text=True, check=False).stdout.strip()
    return {
        "processor": cpu, "processors": len(open("/proc/cpuinfo").read().split("\n\n")) - 1, "kernel": platform.release(), "rustc": rustc,
        "instructions": ours.instructions, "python": platform.python_version(),
        "packages": {name: importlib.metadata.version(name) for name in PACKAGES},
    }  # fmt: skip


def duration(seconds):
    return f"{seconds:.1f} s" if seconds >= 1 else f"{seconds * 1000:.1f} ms"


def ratio(value):
    return f"{value:.0f}" if value >= 20 else f"{value:.2f}" if value < 5 else f"{value:.1f}"


def lines(rows, residuals=False):
    for name, row in rows.items():
        cells = [name, duration(row["median_s"]), ratio(row["ratio"]), f"{ratio(row['least'])} to {ratio(row['most'])}"]
        if residuals:
            cells.append(f"{row['residual']:.1e}" if "residual" in row else "")
        if row.get("calculated"):
            cells[1] += " (calculated)"
        yield "| " + " | ".join(cells) + " |"


def markdown(found):
    about = found["machine"]
    packages = ", ".join(f"{name} {version}" for name, version in about["packages"].items())
    yield f"{about['processor']}, {about['processors']} processors, Linux {about['kernel']}, {about['rustc']}, Python {about['python']}, {packages}."
    yield "\n| gradient vector flow, both surfaces | processor time | ratio | least to most | residual |\n|---|---|---|---|---|"
    yield from lines(found["flow"]["rows"], residuals=True)
    yield "\n| ITK's iterations | relative residual |\n|---|---|"
    for name, course in found["flow"]["itk"].items():
        for count, residual in course["residual"].items():
            yield f"| {count}, {name} (μ {course['mu']:.2g}) | {residual:.2g} |"
    yield "\n| preset `paper`, eight gates | processor time | ratio | least to most |\n|---|---|---|---|"
    yield from lines(found["paper"])
    sides = found["paper"].values()
    yield "\n| stage, last round | Ventricle | numba | libraries |\n|---|---|---|---|"
    for stage in found["paper"]["Ventricle"]["stages"]:
        yield f"| {stage} | " + " | ".join(duration(side["stages"][stage]) for side in sides) + " |"
    yield "\n| gate | endocardial ml: Ventricle | numba | libraries | epicardial ml: Ventricle | numba | libraries |\n|---|---|---|---|---|---|---|"
    for gate, row in enumerate(zip(*(side[of] for of in ("endocardial_ml", "epicardial_ml") for side in sides))):
        yield f"| {gate + 1} | " + " | ".join(f"{value:.1f}" for value in row) + " |"
    yield "\n| piece, one gate | by | processor time | ratio | least to most |\n|---|---|---|---|---|"
    for piece, rows in found["pieces"].items():
        for line in lines(rows):
            yield f"| {piece} {line}"


def main(program, path):
    for limit in (itk.MultiThreaderBase.SetGlobalMaximumNumberOfThreads, itk.MultiThreaderBase.SetGlobalDefaultNumberOfThreads):
        limit(1)
    sitk.ProcessObject.SetGlobalDefaultNumberOfThreads(1)
    ours = Ventricle(program)
    with tempfile.TemporaryDirectory() as folder:
        told = ours.ask(f"export {folder}")
        gates = np.fromfile(Path(folder) / "gates.f32", "<f4").reshape([told["gates"], *told["shape"]])
        maps = [np.fromfile(Path(folder) / f"edges-{name}.f32", "<f4") for name in ("endocardial", "epicardial")]
        maps = [of.reshape(shape) for of, shape in zip(maps, told["map_shapes"])]
    found = {"machine": machine(ours), "rounds": ROUNDS}
    found["paper"] = paper_table(ours, told, gates)
    found["pieces"] = pieces_table(ours, told, gates)
    found["flow"] = flow_table(ours, told, maps)
    ours.end()
    worst = 0.0
    for name in (NUMBA, LIBRARIES):
        pairs = [pair for of in ("endocardial_ml", "epicardial_ml") for pair in zip(found["paper"][name][of], found["paper"]["Ventricle"][of])]
        found["paper"][name]["largest_difference_of_volume"] = max(abs(a / b - 1) for a, b in pairs)
        worst = max(worst, found["paper"][name]["largest_difference_of_volume"])
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    Path(path).write_text(json.dumps(found, indent=1) + "\n")
    print("\n".join(markdown(found)))
    assert worst < 0.05, f"the volumes differ by {worst:.1%}: this is not the same work"


if __name__ == "__main__":
    main(*sys.argv[1:])
