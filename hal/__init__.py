"""Hardware abstraction: state and command types, backends."""
