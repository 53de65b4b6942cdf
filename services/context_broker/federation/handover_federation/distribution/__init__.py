"""Operations that are carried out together with context sources."""
