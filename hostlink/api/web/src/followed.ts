/** A topic of the robot that is shown, subscribed to while its device has it. */

import type { Connection } from "./connection";
import { type LinkView, type RobotView, topicOf } from "./views";

export class Followed<Message> {
  /** What it is subscribed to; "" for none. */
  topic = "";

  private stop = () => {};

  /** `onOther`: another topic from now on, or none. */
  constructor(
    private readonly connection: Connection,
    private readonly leaf: string,
    private readonly type: string,
    private readonly onMessage: (message: Message) => void,
    private readonly onOther: () => void,
  ) {}

  show(robot: RobotView | undefined, link: LinkView | undefined): void {
    const found = robot ? topicOf(robot, link, this.leaf, this.type) : null;
    const wanted = found ?? (robot?.connected && link ? "" : this.topic);
    if (wanted === this.topic) return;
    this.onOther();
    this.stop();
    this.topic = wanted;
    this.stop = wanted ? this.connection.subscribe<Message>(wanted, this.type, this.onMessage) : () => {};
  }
  end(): void {
    this.stop();
    this.topic = "";
    this.stop = () => {};
  }
}
