// An array of numbers from the host, and the arrays of ros_lib's heap to it.
#include <ros.h>
#include <std_msgs/Float32MultiArray.h>
#include <std_msgs/Float64MultiArray.h>
#include <stdlib.h>

ros::NodeHandle nh;
std_msgs::Float32MultiArray answer;
ros::Publisher pub("answer", &answer);

void received(const std_msgs::Float64MultiArray& msg) {
  float sum = 0;
  for (unsigned int i = 0; i < msg.data_length; i++) sum += msg.data[i];
  answer.data[1] = sum;
  pub.publish(&answer);
}

ros::Subscriber<std_msgs::Float64MultiArray> sub("numbers", received);

void setup() {
  answer.layout.dim = (std_msgs::MultiArrayDimension*)malloc(sizeof(std_msgs::MultiArrayDimension));
  answer.layout.dim[0].label = "height";
  answer.layout.dim[0].size = 2;
  answer.layout.dim[0].stride = 2;
  answer.layout.dim_length = 1;
  answer.data = (float*)malloc(sizeof(float) * 2);
  answer.data[0] = 1.0;
  answer.data_length = 2;
  nh.initNode();
  nh.advertise(pub);
  nh.subscribe(sub);
}

void loop() {
  nh.spinOnce();
  delay(1);
}
