"""Acoustic radiance transfer: late sound between patches, along subpaths that all points of a scene share.

The acoustic rendering equation (Siltanen et al. 2007), for the energy B(c, t) that patch c scatters at time t, is

    B = B0 + T B,    so    B = sum over n >= 0 of T^n B0,                                                     (1)

where B0 is what reaches c from the source without an earlier diffuse reflection on a patch, and the operator T
carries what a patch scatters to all others: straight, over specular reflections and through surfaces that
transmit, each with its delay. Patches scatter by Lambert's law, with a BRDF of ρs / π. T belongs to the scene and
is the same for all points.

*Both endpoints.* A path from p to q that a patch scatters is cut at its last such reflection before q, on patch
c. With

    F_q(c, t)  incident histogram: energy of q's subpaths whose first diffuse reflection on a patch is on c,
    V_p(c, t)  outgoing histogram: all energy of p that c scatters, the B of (1) with B0 = F_p,
    R_c        strength of the patch, the integral of ρs over its area,

the fluence at q of a source at p that emits 1 J is

    E_pq(t) = sum over c of (4 / R_c) (V_p(c) ∗ F_q(c))(t),       ∗ convolution over time.                    (2)

Proof: let p and q (an adjoint source of 1 J) bring I_p and I_q, energies per area, to a point of c. A path by way
of it has 4π (ρs / π) I_p I_q dA; with F_q the integral of ρs I_q dA and I_p = V_p / R_c this gives (2). That I_p
is even over a patch is the approximation of this technique; times are rounded besides. Every path is made exactly
once.

*Transfer subpaths.* From every patch M subpaths of unit energy leave as the patch scatters. What one of them
leaves on patch c' after length l estimates the column of the sum over n >= 1 of T^n that belongs to the patch. So
V_p is F_p and, for first reflections r of p that are drawn in proportion to their energy, F_p(r) / P(r) times a
transfer subpath of the patch of r. Both endpoints have short subpaths only. Where a job has few points, each has
transfer subpaths of its own instead, from the patches of the reflections that are drawn: the same estimate from
fewer subpaths (`prepared.settle`).

*Symmetry.* E_pq and E_qp estimate the same energy, and the result is (E_pq + E_qp) / 2. So results are reciprocal
to the bit.

*Variance.* E = ⟨V, F⟩ is bilinear in histograms that are sums over K batches of subpaths. Batch k contributes

    E_k = E (⟨V_k, F⟩ / E + ⟨V, F_k⟩ / E − 1 / K),                                                            (3)

and the variance of E is that of the sum of the E_k (`batch_variance`).

Histograms are decay-compensated (`decay_compensation`) and without air: the air's transmission of a band is a
function of the whole path's length, not a product over its parts. It is applied at the middles of bins.

Modules, in the order in which they are used: `patches`, `patch_visibility`, `patch_construction` (what c is);
`transfer_subpaths` (T); `first_reflections` (F), `patch_histograms` (F and V, over `time_steps`); `product_block`,
`convolution` and `pair_transfer` (2); `arrival_directions`; `batch_variance` (3); `plan`, `prepared`, `transfer`
and `technique` (the technique's face).

Sources: S. Siltanen, T. Lokki, S. Kiminki and L. Savioja (2007), The room acoustic rendering equation, J. Acoust.
Soc. Am. 122 (3), 1624–1635, for (1). H. Bai, G. Richard and L. Daudet (2015), Late reverberation synthesis: from
radiance transfer to feedback delay networks, IEEE/ACM Trans. Audio Speech Lang. Process. 23 (12), 2260–2271.
"""
