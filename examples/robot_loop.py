"""A robot's control loop with an exported policy: python examples/robot_loop.py hopper-reskpn-v730.onnx"""

import sys
import time

from reskpn.policy_file import load

policy = load(sys.argv[1])
step_s = policy.facts["step_s"]
for _ in range(100):
    due_s = time.monotonic() + step_s
    observation = [0.0] * policy.observation_size  # read your sensors here; policy.facts["observation"] names them
    action = policy.act(observation)  # in [-1, 1]; policy.facts["action"] names the actuators
    print(action)  # send it to your motors here
    time.sleep(max(0.0, due_s - time.monotonic()))
