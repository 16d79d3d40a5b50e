"""`reskpn doctor`: find what would keep a run from working on this machine, before it is started."""
