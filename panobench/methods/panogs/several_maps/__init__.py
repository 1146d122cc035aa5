"""Several maps: cuts, looking for the camera in older ones, joining, and maps that are saved."""
