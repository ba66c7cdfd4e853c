"""What we believe about the motor: parameters, effects, models and the kernel that simulates them.

This room knows nothing of logs, boards or estimation. In reduced form a model is ``K/(s (tau s + 1))`` from duty in
percent to angle in degrees, plus effects whose torques are measured in the percent of duty that would balance them.
"""
