"""The path tracer: bidirectional paths, image sources, diffraction and radiance transfer.

    bsdf, scene_surfaces     how surfaces reflect, scatter and transmit, and which of them a scene has
    paths                    subpaths of points: emission, `advance`, receiver volumes, connections, MIS weights
    arrivals                 direct sound, image sources, and ways round edges
    radiance_transfer        late sound from patch to patch
    low_method               sound below the first band's edge by a neighbour (no paths)
    techniques, technique    which technique makes which paths, and what one consists of
    state, tables            records of kernels, and where energy enters a table
    preparation, model, tile a scene, and a block of pairs, in the kernels' form
    integrator, simulate     the loop over the techniques; what users call

Notation follows Georgiev 2012 ("Implementing vertex connection and merging"): `d_vcm`, `d_vc` are the
recursive MIS quantities, `pdf_w` is per steradian, `pdf_a` per square metre. `docs/theory.md`
derives the weights. Lengths are metres, energies fractions of the 1 J that a source emits per band.
"""
