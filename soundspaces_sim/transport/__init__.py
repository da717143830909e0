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
