/** Entry of the player build: what pages get as `MovesetPlayer`. */
export const version = 1;
