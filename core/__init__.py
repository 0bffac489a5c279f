"""The ground floor: what every room builds on and none of them owns."""
