"""What the contacts say together: A(P), profiles, power laws, friction; and the topography behind them."""
