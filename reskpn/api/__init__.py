"""The Python interface: `import reskpn` has its names."""
