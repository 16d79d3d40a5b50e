"""Ways to keep the RKHS part h of the policy: one interface, one file each.

exact       h = sum_i w_i K(c_i, .), every transition a centre, the oldest evicted
cluster     exact, but a transition near a centre joins it
kmp         exact, but centres that others can stand in for are taken out (kernel matching pursuit)
nystrom     the functional gradient projected onto the span of fixed landmarks
rff         random Fourier features
basis       the first functions of an orthonormal basis of the Gaussian kernel's space
"""
