// Starts the players of a page: the first one at once, the others when they are asked for; one at a time.
import "./enlarge.js";
import { Player } from "./player.js";
import { give } from "./source.js";

globalThis.rogsScene = give;
const players = { current: null };
globalThis.rogsPlayers = players;

function openIn(place) {
  players.current?.close();
  if (players.place) restore(players.place);
  players.place = place;
  players.current = new Player(place);
  players.current.ready.catch((error) => console.warn(error.message));
}

/** Puts back what stood in the place of a player. */
function restore(place) {
  place.replaceChildren(...place.poster);
}

function prepare(place, index) {
  const button = document.createElement("button");
  button.type = "button";
  button.className = "player-open";
  button.textContent = "Open the player";
  button.onclick = () => openIn(place);
  place.prepend(button);
  place.poster = [...place.childNodes];
  if (index === 0) openIn(place);
}

function begin() {
  document.querySelectorAll(".player[data-scenes]").forEach(prepare);
}

if (document.readyState === "loading") document.addEventListener("DOMContentLoaded", begin);
else begin();
