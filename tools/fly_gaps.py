"""An AirSim script: what a gap between two commands leaves of the speed, and how far a command with its gap flies.

    uavaccel fly --timing lockstep --profile airsim tools/fly_gaps.py > docs/tables/gaps.csv

Each line is of the last of six commands of one second, northwards at 1 m/s, with a gap after each.
"""

import time

import airsim

GAPS_S = 0.0, 0.066, 0.2, 0.33, 0.66, 1.2, 2.0, 3.7, 4.9, 11.6

client = airsim.MultirotorClient()
print("gap_s,speed_m_s,way_m")
for gap_s in GAPS_S:
    client.reset()
    client.enableApiControl(True)
    client.armDisarm(True)
    for _ in range(6):
        before = client.getMultirotorState().kinematics_estimated
        client.moveByVelocityAsync(1, 0, 0, 1).join()
        time.sleep(gap_s)
    after = client.getMultirotorState().kinematics_estimated
    print(gap_s, after.linear_velocity.x_val, after.position.x_val - before.position.x_val, sep=",")
