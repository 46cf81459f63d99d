"""The prediction of estimates: the noise of a step, and steps whose lengths follow from tolerances."""
