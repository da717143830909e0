"""What arrives discretely: direct sound, reflections off planes, sound round edges, and both mixed.

The pressure at q of a source of e^(-jkr) / r at p is a sum of waves, each with a length l_i and a pressure P_i(k),

    p(k) = sum_i P_i(k) e^(-jk l_i)                                                                            (T29)

and every wave meets at most two planes, one edge or two, or a plane and then edges; or it is the shortest way round
up to eight edges. Numbers are those of docs/theory.md, section 5. A scene once:

    specular_planes, prepared     triangles grouped by plane equation
    find_wedges, wedges           convex creases and free borders: wedges of open angle n pi
    scene_edges                   which wedges see each other, which a face connects, which planes end there

A point once, for all its pairs: `sight` has the planes that its rays meet, the wedges that it sees, and those that
its images see by way of large planes; `ways` has its shortest ways to all wedges. An *end* is a point or such an
image; what follows takes ends alike.

A pair (`connect`, the one kernel), in four steps:

 1. Candidates. Tables of both ends are joined by wedge, or by two wedges of one face. What one of them may have at
    most is estimated from the tables (T35), and what nobody hears beside the rest goes no further. Points that do
    not see each other also have the ways of either to the wedges that the other one sees.
 2. Geometry. Images by unfolding (`images`); Keller's cone on one edge; the shortest path by two
    parallel lines (`two_edges`); a way is pulled taut. Rays decide what is there.
 3. Field. sqrt(rho (1 - s)) for every plane, (T29a). One edge: the uniform theory of diffraction,
        P ~ sum over Theta, ± of cot((pi ± Theta) / 2n) F(k L a±(Theta)) S                              (T30)
    with all four terms as one wave, in the light as in the shadow, those of faces by what these reflect (T32), and
    the share S of what comes from between the edge's ends (T33a): so the sum (T29) is continuous where direct sound
    or reflections end, at corners too. Two edges of one rigid face: exact, waves to and fro included (T34,
    `double_wedge`). A way: by its length alone (T34e).
 4. Sum (`waves`). An arrival of an echogram has an energy and the phase of its delay alone. So what is diffracted
    joins, as a pressure, what it arrives together with,
        P_j <- P_j + a_ij P_i e^(-jk (l_i - l_j))                                                       (T36)
    within a band's coherence length. The sum stays as it is at every wave number.

A pair is solved from the end of the smaller key: both directions have the same bits, in any tile.
"""
