"""The circle of one wide, smooth contact."""
