"""What a problem states: phases, objective, conditions, constraints, and how it is solved."""
