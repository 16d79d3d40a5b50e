"""A trained policy as a file that runs without this package: traced by JAX, written as ONNX or StableHLO, verified.

graph        ONNX nodes, constants and names
operations   one ONNX translation for each JAX operation
selections   the translations of slices, gathers and scatters
translate    a traced function as an ONNX model
policy       the policy of a run as a function of raw observations
simulation   the physics of a task: the functions around a MuJoCo step, and initial states
verify       a file against the trained policy on logged observations, and its latency
"""
