"""A MAX30100 pulse oximeter on an M5StickC that sends JSON over UDP."""
