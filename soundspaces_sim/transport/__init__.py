"""Numba kernels of the path tracer; each module is one step of the pipeline.

    rng, sampling, surface   random streams, directions, what a wall does
    detector                 the visible neighbourhood in which a point detects passing walks
    walk                     emission and bounces; every walk serves as source walk and listener walk
    specular                 walks that only mirror
    hits                     a walk passes through a detector
    join                     a walk's vertex is joined to the other point, or to the other point's walk
    patches, merge           halves of late paths that meet on a patch of surface
    planes, mirror, direct   deterministic early paths
    deposit                  where energy enters a table

Notation follows Georgiev 2012 ("Implementing vertex connection and merging"): `d_vcm`, `d_vc` are the
recursive MIS quantities, `pdf_w` is per steradian, `pdf_a` per square metre. `docs/transport.md`
derives the weights. Lengths are metres, energies fractions of the 1 J that a source emits per band.
"""

from pathlib import Path as _Path


def _drop_stale_kernels() -> None:
    """Delete compiled kernels that are older than any kernel source.

    Numba keys its cache by the file of the compiled function alone, but kernels have constants and
    functions of other files compiled in: after an edit or a `git pull` it would run a mixture.
    """
    package = _Path(__file__).parents[1]
    sources = [*package.glob("transport/*.py"), package / "embree.py", package / "synthesis.py"]
    newest = max(path.stat().st_mtime for path in sources)
    for folder in (package, package / "transport"):
        for index in folder.glob("__pycache__/*.nbi"):
            try:
                if index.stat().st_mtime < newest:
                    index.unlink()
            except OSError:  # another process was first, or the installation is read-only and whole
                continue


_drop_stale_kernels()
