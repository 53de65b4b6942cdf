"""Any Bluetooth heart rate strap or watch that offers the standard heart rate service."""
