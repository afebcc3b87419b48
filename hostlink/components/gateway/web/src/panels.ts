/** The table of panels: name, title, layouts and start function. */

import { startDrives } from "./drives";
import { startIncidents } from "./incidents";
import type { Place } from "./layouts";
import type { Page } from "./page";
import { startRecordings } from "./recordings";
import { startTopics } from "./topics";

/** The daemon's events, or topics over the WebSocket. */
export type Feed = "events" | "topics";

export interface Panel extends Place {
  title: string;
  /** Whether a phone shows it on the first screen of the driving layouts; the others are below. */
  isFirst?: boolean;
  /** What brings its values, whose age it shows when that is lost. Without it the panel shows the age by itself. */
  feed?: Feed;
  /** Makes the panel's element, a section whose id is `name`. Without it index.html has the section. */
  start?: (page: Page) => HTMLElement;
}

/** In their order within a column. */
export const PANELS: readonly Panel[] = [
  {
    name: "robots",
    title: "Robots",
    isFirst: true,
    places: { Drive: "left", Tune: "left", Fleet: "middle", Watch: "left" },
  },
  { name: "map", title: "Map", isFirst: true, places: { Drive: "middle", Fleet: "right", Watch: "middle" } },
  { name: "drive", title: "Drive", isFirst: true, places: { Drive: "left", Tune: "left" } },
  { name: "link", title: "Link", feed: "events", isFirst: true, places: { Drive: "right", Watch: "left" } },
  {
    name: "speeds",
    title: "Commanded and measured",
    places: { Drive: "middle", Watch: "middle" },
    wide: { Drive: "right", Watch: "right" },
  },
  { name: "steps", title: "Step response", places: { Tune: "middle" } },
  { name: "plots", title: "Wheels", feed: "topics", places: { Tune: "middle" }, wide: { Tune: "right" } },
  { name: "tuning", title: "PID tuning", places: { Tune: "right" } },
  { name: "topics", title: "Topics", feed: "events", places: { Watch: "middle" }, start: startTopics },
  { name: "recordings", title: "Recordings", feed: "events", places: { Watch: "left" }, start: startRecordings },
  { name: "incidents", title: "Incidents", places: { Watch: "right" }, start: startIncidents },
  { name: "drives", title: "Drive history", feed: "events", places: { Watch: "right" }, start: startDrives },
  { name: "log", title: "Log", places: { Drive: "right", Watch: "right" } },
  { name: "clients", title: "Clients", feed: "events", places: { Drive: "right", Fleet: "right", Watch: "right" } },
];
