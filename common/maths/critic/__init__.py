"""The kernel critic: V(s) = V_net(s) + g(s), g in closed form.

`functions` are what g is a sum of, `ridge` fits and judges it, `kernel_critic` puts both into the update.
"""
