"""The Dynamixel XL430-W250 bus: driver, emulated servos on a pseudo-terminal, tools."""
