"""Parts of the documentation that are generated from the code, for `slot_bringup/doc/conf.py`."""
