"""What is left of a true model: sensor noise, a random torque, counts. Estimation, whitening, draws; arrays only."""
