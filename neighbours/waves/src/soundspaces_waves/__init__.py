"""Sound below the first band's edge as waves: finite differences in time on a cubic lattice.

    import soundspaces_sim as ss, soundspaces_waves as sw
    low = sw.simulate_low(ss.load_scene("demo"), sources, listeners, duration=0.5)

    lattice     cells from the edge's wavelength; rays along the links between them
    branches    walls and layers as passive branches (mass, resistance, stiffness), fitted to the table
    operator    volumes, areas and weights of the lattice; the time step
    row_algebra rows of `LANES` numbers in kernels: one lane per source
    stepping    the time loop
    placing     points between cells
    dispersion  the lattice's frequencies and amplitudes, put right
    solve       sources and listeners in, responses out
    measures    room measures, and what they are known to

Conventions: pressures are those of a source whose free field is 1 / (sqrt(4 pi) r), so that squares are
fluences for 1 J as everywhere here; velocities are -rho c u, in the unit of pressure. Impedances are over that
of air, volumes and areas of cells over h³ and h², with h the lattice's spacing; `courant` is c T / h. Equations
are in docs/theory.md, section 10. The scheme is the interpolated leapfrog scheme of 19 points (Kowalczyk & van
Walstijn 2011) as a finite-volume method (Bilbao, Hamilton, Botts & Savioja 2016), with cells cut by the walls.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
