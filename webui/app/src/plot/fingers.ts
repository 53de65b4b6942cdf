/** The dashes that distinguish the lines of the five fingers, thumb first, without colour. */
export const dashes = [[], [10, 4], [3, 3], [10, 3, 3, 3], [16, 5]];
