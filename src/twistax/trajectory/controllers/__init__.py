"""Model-predictive control: a problem solved again and again from measured states."""
