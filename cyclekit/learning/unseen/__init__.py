"""An operator whom no log shows: what the speed scaling alone says of people in the cell."""
