// A line of each level.
#include <ros.h>
#include <std_msgs/String.h>

ros::NodeHandle nh;
char debug[] = "debug statements";
char info[] = "infos";
char warn[] = "warnings";
char error[] = "errors";
char fatal[] = "fatalities";

void setup() {
  pinMode(13, OUTPUT);
  nh.initNode();
}

void loop() {
  nh.logdebug(debug);
  nh.loginfo(info);
  nh.logwarn(warn);
  nh.logerror(error);
  nh.logfatal(fatal);
  nh.spinOnce();
  delay(500);
}
