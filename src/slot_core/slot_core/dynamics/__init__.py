"""The robot as equations: rod, tendon, contact, torso and servo, and their time integration."""
