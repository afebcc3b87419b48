// Shows every robot and its pose, twice a second; the one thing that it can do is stop one.
"use strict";

const INTERVAL_MS = 500;
const state = document.getElementById("state");
const rows = document.getElementById("robots");

function number(value, digits) {
  return value === undefined || value === null ? "–" : value.toFixed(digits);
}

function row(robot) {
  const line = document.createElement("tr");
  line.classList.toggle("gone", !robot.connected);
  const odometry = robot.odometry;
  const cells = [
    robot.name + (robot.connected ? "" : " (not connected)"),
    number(odometry?.pose.x_m, 3),
    number(odometry?.pose.y_m, 3),
    number(odometry && (odometry.pose.theta_rad * 180) / Math.PI, 1),
    number(odometry?.twist.linear_m_s, 3),
    number(odometry?.twist.angular_rad_s, 3),
    robot.holder ?? "–",
    number(odometry?.age_s, 1),
  ];
  for (const text of cells) line.insertCell().textContent = text;
  const stop = document.createElement("button");
  stop.textContent = "stop";
  stop.onclick = () => fetch(`api/robots/${encodeURIComponent(robot.name)}/stop`, { method: "POST" });
  line.insertCell().append(stop);
  return line;
}

async function refresh() {
  try {
    const { robots } = await (await fetch("api/robots")).json();
    rows.replaceChildren(...robots.map(row));
    state.textContent = robots.length ? `${robots.length} robot(s)` : "no robot has connected yet";
  } catch {
    state.textContent = "no connection to hostlink: is hostlink serve still running?";
  }
  setTimeout(refresh, INTERVAL_MS);
}

refresh();
