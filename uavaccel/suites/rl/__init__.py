"""The paper's RL experiment: policies trained under a command and a ClockSpeed, flown in real time (section IV-D)."""
