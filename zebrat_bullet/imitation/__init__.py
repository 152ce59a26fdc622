"""Learning from whoever drives: demonstrations, behaviour cloning, DAgger."""
