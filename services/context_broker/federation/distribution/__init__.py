"""Operations in which other context sources have a share."""
