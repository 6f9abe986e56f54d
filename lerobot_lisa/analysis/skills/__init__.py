"""What do skills mean? Which codes are chosen, which words go with them, and what is done under each."""
