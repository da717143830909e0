"""The path tracer, in the order in which sound meets it; each module is one step.

    model                    a scene brought into the kernels' form
    surface, lobes/          what a wall does: choose a lobe, weigh it, its densities
    emit, walk, bounce       sound is emitted, travels, bounces; every walk serves as a source's and a listener's
    population               copies of heavy walks in the place of light ones
    detector, detect         the visible neighbourhood of a point, and walks that pass it
    patches, planes          pieces of surface on which halves meet; planes that mirror early sound
    techniques/              the ways of making a path, one file each, and which path is whose
    mis                      their weights
    tables                   where energy enters a table
    state, tile              the records that kernels and the host pass on
    integrator, simulate     the loop over the techniques; what users call

Notation follows Georgiev 2012 ("Implementing vertex connection and merging"): `d_vcm`, `d_vc` are the
recursive MIS quantities, `pdf_w` is per steradian, `pdf_a` per square metre. `docs/theory.md`
derives the weights. Lengths are metres, energies fractions of the 1 J that a source emits per band.
"""
