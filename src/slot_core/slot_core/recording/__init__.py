"""Recording: bag writer, message types, origin of a bag."""
