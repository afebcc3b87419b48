// The host's time on "clock", ten times a second, and lines of each level in the host's log.
#include <ros.h>
#include <std_msgs/Time.h>

ros::NodeHandle nh;
std_msgs::Time now;
ros::Publisher publisher("clock", &now);
unsigned long published_at = 0;
bool was_connected = false;

void setup() {
  nh.initNode();
  nh.advertise(publisher);
}

void loop() {
  nh.spinOnce();
  if (nh.connected() && !was_connected) {
    nh.logdebug(F("debug"));
    nh.loginfo(F("connected"));
    nh.logwarn(F("a warning"));
    nh.logerror(F("an error"));
  }
  was_connected = nh.connected();
  if (millis() - published_at < 100) return;
  published_at = millis();
  now.data = nh.now();
  publisher.publish(&now);
}
