"""The loop over steps: fixed or chosen by tolerances, with saved times and events, as one compiled function."""
