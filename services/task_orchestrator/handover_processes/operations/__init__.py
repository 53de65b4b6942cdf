"""Operations: each computes a change and applies it by the step writer, one module a responsibility."""
