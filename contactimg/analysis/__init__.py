"""What the contacts say together: profiles, areas."""
